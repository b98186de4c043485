"""All limits of the detector of pulses, each with where it comes from.

Where a line names nobody, the value is a choice of this program, and the measurements in
``docs/features.md`` were made with it.

References
----------
.. [1] M. Elgendi et al., "Systolic peak detection in acceleration photoplethysmograms measured
   from emergency responders in tropical conditions", PLoS ONE 8 (2013) e76585.
.. [2] M. Elgendi, "Optimal signal quality index for photoplethysmogram signals", Bioengineering
   3 (2016) 21.
"""

BAND_HZ = (0.5, 8.0)
PEAK_S, BEAT_S = 0.111, 0.667
"""[1]_: the two moving averages."""
AHEAD_S = 0.15
"""How far the longer mean looks ahead; by 0.28 s in [1]_, where it is centred."""
OFFSET = 0.02
"""[1]_: beta, of the mean of the squared signal."""
MEAN_S = 3.0
"""How long that mean looks back."""
SKEWNESS = 0.3
"""[2]_: a good pulse is skewed to the right, so one that is skewed to the left by this much is
upside down."""
SKEWNESS_PIECE_S, SKEWNESS_PIECES = 2.0, 8
"""It is told of pieces of this length, and the median of so many decides."""
LEAST_SHARE, RISE_S = 0.15, 0.4
"""What rises by less than this share of what is usual, within this time before its top, is no
pulse: between slow ones the filter makes waves of its own."""
EARLY_S, EARLY_SHARE = 0.27, 0.4
"""A pulse may come so soon after another, and has at least this share of the usual height."""
VALLEY_SHARE = 0.25
REFRACTORY_S = 0.2
"""No pulse follows another within it."""
KEPT = 8
"""Pulses of which medians are taken."""
LOST_S = 4.0
"""Without a pulse for so long, the usual size is forgotten: a sensor may have been moved."""
