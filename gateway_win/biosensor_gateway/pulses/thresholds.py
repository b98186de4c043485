"""All limits of the pulse detector, each with its source.

Without a source, the value is a choice of this program; the measurements in ``docs/features.md``
were made with it.

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
"""[1]_: beta, relative to the mean of the squared signal."""
MEAN_S = 3.0
"""Length of that mean."""
SKEWNESS = 0.3
"""[2]_: a good pulse is skewed to the right; with this skewness to the left, it is upside down."""
SKEWNESS_PIECE_S, SKEWNESS_PIECES = 2.0, 8
"""Length of the pieces whose skewness is computed, and number of pieces for the median."""
LEAST_SHARE, RISE_S = 0.15, 0.4
"""Smallest rise of a pulse, as a share of the usual rise, within this time before its top; the
filter makes smaller waves between slow pulses."""
EARLY_S, EARLY_SHARE = 0.27, 0.4
"""Shortest interval to an early pulse, and its least share of the usual height."""
VALLEY_SHARE = 0.25
REFRACTORY_S = 0.2
"""Shortest interval between two pulses."""
KEPT = 8
"""Number of pulses for medians."""
LOST_S = 4.0
"""Time without a pulse after which the usual size is reset: the sensor may have been moved."""
