"""All limits of the detectors, each with its source.

Without a source, the value is a choice of this program; the measurements in ``docs/features.md``
were made with it.

References
----------
.. [1] P. S. Hamilton, "Open source ECG analysis", Computers in Cardiology 29 (2002) 101-104.
.. [2] M. Elgendi, "Fast QRS detection with an optimized knowledge-based method", PLoS ONE 8
   (2013) e73557.
.. [3] M. Elgendi et al., "Systolic peak detection in acceleration photoplethysmograms measured
   from emergency responders in tropical conditions", PLoS ONE 8 (2013) e76585.
.. [4] M. Malik et al., "Heart rate variability in relation to prognosis after myocardial
   infarction: selection of optimal processing techniques", European Heart Journal 10 (1989)
   1060-1074.
.. [5] Task Force of the ESC and NASPE, "Heart rate variability", Circulation 93 (1996) 1043-1065.
.. [6] W. Boucsein et al., "Publication recommendations for electrodermal measurements",
   Psychophysiology 49 (2012) 1017-1034.
.. [7] I. R. Kleckner et al., "Simple, transparent, and flexible automated quality assessment
   procedures for ambulatory electrodermal activity data", IEEE Transactions on Biomedical
   Engineering 65 (2018) 1460-1467.
.. [8] Q. Li et al., "Robust heart rate estimation from multiple asynchronous noisy sources using
   signal quality indices and a Kalman filter", Physiological Measurement 29 (2008) 15-32.
.. [9] M. Elgendi, "Optimal signal quality index for photoplethysmogram signals", Bioengineering
   3 (2016) 21.
.. [10] H. Vaha-Ypya et al., "A universal, accurate intensity-based classification of different
   physical activities using raw data of accelerometer", Clinical Physiology and Functional
   Imaging 35 (2015) 64-70.
.. [11] D. Khodadad et al., "Optimized breath detection algorithm in electrical impedance
   tomography", Physiological Measurement 39 (2018) 094001.
.. [12] D. Makowski et al., "NeuroKit2: a Python toolbox for neurophysiological signal processing",
   Behavior Research Methods 53 (2021) 1689-1696.
.. [13] C. Orphanidou et al., "Signal-quality indices for the electrocardiogram and
   photoplethysmogram: derivation and applications to wireless monitoring", IEEE Journal of
   Biomedical and Health Informatics 19 (2015) 832-838.
.. [14] J. Lafler, T. D. Kinman, "An RR Lyrae star survey with the Lick 20-inch astrograph. II. The
   calculation of RR Lyrae periods by electronic computer", Astrophysical Journal Supplement 11
   (1965) 216-222.
"""

HOP_S = 0.1
"""ECG is computed in steps of this length, counted from the start of a run."""
GAP_PERIODS, FOREIGN_JITTER_S = 1.5, 0.1
"""As in the node and in ``xdf check``: two samples further apart are not neighbours."""
HOLE_S = {"ECG": 0.05, "PPG": 0.05, "GSR": 0.5, "Respiration": 0.25, "Accelerometer": 0.25}
"""What is lost for no longer hides nothing: of beats at most one on which it lies, and that is told
by its rule of artefacts; a response rises for 1 s at least [6]_, a breath lasts as long, and of
acceleration 5 s are looked at."""

STEP_BACK_S = 1.0
"""Stamps that step back by more begin again; a sample that is late by less is left out."""

LARGEST_VALUE = 1e12
"""No unit of a body's signal has larger ones, and their squares are still numbers."""

ECG_BAND_HZ = (8.0, 20.0)
"""[2]_: what QRS complexes have and T waves and muscles have not."""
ECG_FILTER_S = 0.2
QRS_S = 0.097
"""[2]_: W1, how long a QRS complex lasts."""
QRS_NEIGHBOUR_S = 0.1
"""Half of the refractory time: the largest peak within it stands for all others."""
REFRACTORY_S = 0.2
"""[1]_: no beat follows another within it."""
T_WAVE_S, T_WAVE_SHARE = 0.36, 0.5
"""[1]_: what follows within this time and has less than this share of the slope is a T wave."""
DETECTION_THRESHOLD = 0.3125
"""[1]_: between the median of noise peaks (0) and that of QRS peaks (1)."""
SEARCH_BACK_INTERVALS, SEARCH_BACK_SHARE = 1.5, 0.5
"""[1]_: after so many usual intervals, a peak above this share of the threshold is a beat."""
PEAKS_KEPT = 8
"""[1]_: of which medians are taken."""
GROWN_LAST, GROWN_TIMES = 3, 8.0
"""Of so many beats, two with so many times the usual energy are of a signal that has grown."""
HUGE_TIMES, HUGE_IN_A_ROW, HUGE_APART_S = 50.0, 3, 2.5
"""With so many times the energy, so many peaks that are no further apart than the beats of the
slowest heart are its beats, whatever was called a beat between them."""
LEARNING_S, LEARNING_ALIKE, LEARNING_ARTEFACTS = (3.0, 8.0), 0.1, 2
"""[1]_ learns from 8 s; the largest peaks of each second, as there. Shorter where none of them has
less than this share of the largest; else, so many may be artefacts, and the next one counts."""
LOST_S = 4.0
"""Without a beat for so long, learning begins again: electrodes may have been changed."""
APEX_S = 0.08
"""How far from the middle of its energy the apex of a QRS complex may be."""

PULSE_RATE_HZ = 100.0
"""What is faster is averaged to between this and twice as much."""

INTERVAL_S = (0.3, 2.0)
"""[5]_: 30 to 200 beats a minute."""
INTERVAL_CHANGE = 0.2
"""[4]_: an interval that differs more from the one before it is none between normal beats."""
NN50_S = 0.05
"""[5]_."""
RATE_INTERVAL_S = (0.24, 2.5)
"""24 to 250 beats a minute: between these, an interval may be one of an irregular rhythm."""
HR_WINDOW_S, HR_LEAST = 10.0, 3
HR_VALID_SHARE = 0.8
"""With fewer valid intervals all count if the signal is good, and none does if it is not."""
HR_FEW_INVALID, HR_FEW_SHARE = 3, 0.4
"""One false beat makes three intervals invalid; up to this share of few is no irregular rhythm."""
HR_USUAL_TIMES = 1.7
"""By this factor, valid intervals may differ from their median: two beats missed in a row make two
long intervals, of which the second is like the one before."""
HR_APART_PER_MIN, HR_APART_QUALITY = 3.0, 0.4
"""By how much the rate of all intervals may differ from that of those which are taken, and above
what the quality is not if it does."""
HR_ONCE, HR_TWICE, HR_ONCE_SHARE = 0.12, 0.16, 0.6
"""By how much of the usual interval others differ that are as long, or twice as long as one where a
beat was missed; and how many of all are as long. Of early beats and pauses, half are neither."""
HIDDEN_SHARE, HIDDEN_ALIKE, HIDDEN_EARLY_ALIKE = 0.06, 0.9, 0.85
"""Which share of the size of a beat a wave between two of them has, and how much it correlates with
them, to be a beat that was left out; less if it is early, on the slope of a T wave."""
NARROW_S, NARROW_SHARE = 0.03, 0.75
"""A QRS complex of which so much is within this time of its apex is narrow: no T wave correlates
with it by more than 0.6. Of others, no early wave is a beat."""
HIDDEN_LEAST, HIDDEN_PART = 2, 0.3
"""One in a window may be noise, unless it is such a part of the intervals that were looked at."""
HIDDEN_KEPT_S, HIDDEN_SLOW_S = 5.0, 1.2
"""How long ago the first of two beats may be; and from which interval on the waves of a beat come
later, by the square root, as the QT interval (Bazett 1920)."""
HR_QUALITY_AGE_S = 1.5
"""How old the newest quality of a window may be; there is one every second."""
HRV_WINDOWS_S = (30.0, 60.0, 300.0)
HRV_LEAST_SHARE = 0.8
"""With fewer valid intervals in a window, or where these cover less of it, there is no value."""

EDA_RATE_HZ = 8.0
SCL_WINDOW_S, SCL_EVERY_S = 8.0, 1.0
"""The tonic level is the median of the window."""
SCR_SMOOTHING_S = 0.5
SCR_LEAST_MICROSIEMENS = 0.02
"""[6]_: 0.01 to 0.05 uS are usual."""
SCR_NOISE_S, SCR_NOISE_TIMES = 30.0, 6.0
"""What is less than so many standard deviations of the noise of late is no response: three for its
peak and three for its trough, the limit of detection of IUPAC."""
SCR_PROMINENT_SHARE, SCR_LARGEST_S = 0.1, 300.0
"""[12]_: of the largest response of a recording; here of the second largest of five minutes."""
SCR_STEEP_S = 3.0
"""[6]_: a response rises for 1 to 3 s, so that what rises before is its level."""
SCR_FALLS_S = 0.25
"""How long after its peak a response has fallen by half of the least one, usually."""
SCR_RISE_S = (0.25, 10.0)
"""[6]_: 1 to 3 s are typical; what overlaps takes longer, and a jump is none."""

BREATH_RATE_HZ = 10.0
BREATH_BAND_HZ = (0.05, 0.8)
BREATH_HYSTERESIS = 0.3
"""[11]_, as in [12]_: turning points that are closer than this share of the usual are none."""
BREATH_BLOCK_S, BREATH_BLOCKS = 3.0, 7
"""How long the signal is looked at to say how far it moves, and of how many of these the median is
taken."""
BREATH_BLOCKS_LONG, BREATH_LONG_SHARE = 24, 0.55
"""The upper quartile of so many blocks, 72 s, outlasts a breath that is held for 50 s."""
BREATH_NOISE_TIMES, BREATH_NOISE_SHARE = 6.0, 0.6
"""A turn is this many standard deviations of noise, but this share of the usual span is enough."""
OF_MEDIAN = 1.4826
"""Standard deviation of normal values, relative to the median of their sizes."""
BREATH_INTERVAL_S = (1.0, 20.0)
BR_WINDOW_S, BR_LEAST = 30.0, 2
BR_ALIKE = 1.6
"""By this factor an interval may differ from their median; a breath missed makes it 2."""

ACTIVITY_EPOCH_S = 5.0
"""[10]_: mean amplitude deviation of epochs."""
STANDARD_GRAVITY = 9.80665

MOTION_PIECE_S, MOTION_WINDOW_S, MOTION_LEAST_S = 1.0, 10.0, 3.0
"""Each piece is judged by itself; so many seconds of motion in a window are motion."""
MOTION_LEAST_G = 0.04
"""How far acceleration is from its mean, as a root of the mean square. Who sits and types stays
below it, and who walks is at 0.1 and more."""
MOTION_QUALITY = 0.4
"""The quality of a pulse is not above it while its wearer moves."""
MOTION_KEPT_S = max(HRV_WINDOWS_S) + 60.0

QUALITY_WINDOW_S = {"ECG": 10.0, "PPG": 10.0, "GSR": 10.0, "Respiration": 30.0}
QUALITY_EVERY_S = 1.0
"""A window ends so long after the one before: what a value is of is known soon."""
STATE_EVERY_S = 1.0
GOOD_QUALITY = 0.5
FLAT_SHARE, FLAT_RUN_S = 0.5, 1.0
"""Of the time, in runs of one value that last so long."""
CLIPPED_SHARE, CLIPPED_APPROACH, CLIPPED_APPROACH_S = 0.01, 0.05, 0.05
"""Of the time, at one of the ends, which was come to by this share of what is between the ends, or
more, within this time."""
CLIPPED_TO_BELOW = 3.0
"""How much longer a signal is at such an end than at the level before it."""
FINE_STEPS, REPEAT_BITS = 1.0, 16.0
"""The least steps of a converter that noise has by its standard deviation, for repeats to be none
of chance; and how many bits more they tell than are needed to name their places, so that one in
65,000 windows has some by chance."""
HELD_S, HELD_USUAL, HELD_TIMES = 0.2, 0.9, 5.0
"""A value is held if it stays for so long, and for so many times this quantile of shorter runs.
Recorders that compress hold an ECG between its waves for up to 0.15 s."""
TWICE_S, TWICE_LEAST = 0.2, 10
"""Least length of a part that is looked for again, in time and in samples."""
ECG_KURTOSIS = (3.0, 5.0)
"""[8]_: noise has 3, a good ECG more than 5."""
ECG_QRS_SHARE = (0.3, 0.5)
"""[8]_: power of 5 to 15 Hz to that of 5 to 40 Hz; good from 0.5 on."""
ECG_BASELINE_SHARE = (0.3, 0.7)
"""[8]_: power of 1 to 40 Hz to that of all up to 40 Hz."""
ECG_HUM_SHARE = (0.5, 0.8)
"""Power of 1 to 40 Hz to that of everything above 1 Hz."""
PPG_BAND_SHARE = (0.6, 0.9)
"""Power of 0.5 to 8 Hz to that of everything."""
PPG_OTHER_WAVES, PPG_LINE_HZ = (0.06, 0.2), 0.35
"""Power further from the strongest frequency, to that of the whole band. Sines with overtones of a
fifth have 0.04, those of arms that swing 0.08 to 0.12, and real pulses 0.2 and more."""
PPG_ROUND_HZ = 2.0
"""From this rate on, a pulse has the less of it the faster it is, by the third power."""
PPG_APART = (0.004, 0.012)
"""[14]_, of waves laid over each other; 1 where they have nothing to do with each other. Those of
a lamp have up to 0.005 with noise of a tenth; of 445 windows of real pulses none is below 0.017."""
PPG_APART_STEPS_HZ, PPG_APART_NEAR = (0.002, 0.0005), 0.1
"""How finely the period is looked for, where it is near: waves at both ends of a window are then
apart by less than a hundredth of one. From this on it is not near."""
PPG_APART_RATE_HZ, PPG_APART_SMOOTH_S = 50.0, 0.25
PPG_APART_TRIMMED, PPG_APART_NOISE = 0.02, 1.25
"""This share of the largest differences is left out, for edges are steep. Of the variance of noise,
0.86 times is left then; more is subtracted, because it is known roughly."""
PPG_NOISE_HZ = 4.0
"""What is between the overtones of a pulse from this frequency on is noise."""
PPG_SECOND_HZ, PPG_SECOND_NEAR_HZ = (0.7, 3.5), 0.25
"""Where the rates of hearts and of steps are, and how wide a line is in a window of 10 s."""
PPG_SECOND_SHARE, PPG_SECOND_ALONE = 0.01, (0.85, 0.95)
"""Of the power of all, and of what does not belong to the strongest waves: of irregular rhythms,
whose lines are broad, up to 0.86 is near any one frequency, and of a pulse below steps 0.9 and
more."""
PPG_SECOND_FRACTION_HZ, PPG_SECOND_FRACTIONS = 0.2, (2, 3, 4)
"""What is so near to such a part of the strongest frequency is the rate of which that is an
overtone."""
PPG_HUM_HZ, PPG_HUM_BELOW_HZ, PPG_HUM_SHARE = 3.6, 2.0, (0.08, 0.2)
"""From the highest rate of hearts on, so much more of all power at one frequency than at any that
is lower by up to 2 Hz."""
PPG_SKEWNESS = (-1.0, 0.0)
"""[9]_: a good pulse is skewed to the right."""
ECG_LIKENESS, PPG_LIKENESS = (0.5, 0.82), (0.76, 0.96)
"""[13]_: the mean correlation of beats with their template; good from 0.66 and 0.86 on, which are
in the middle here."""
ECG_TEMPLATE_S, PPG_TEMPLATE_S = (0.25, 0.35), (0.35, 0.35)
"""What is compared: so long before and after the top."""
TEMPLATE_RATE_HZ = 125.0
TEMPLATE_APART_S, TEMPLATE_SHARE, TEMPLATE_LEAST = 0.25, 0.25, 3
"""How far tops are apart, of which share of the usual height they are, how many there must be."""
ECG_UNEVENNESS, PPG_UNEVENNESS = (1.2, 1.6), (2.0, 4.0)
"""What the wildest block of a window spans, of what the usual one does: electrode pops."""
ECG_BLOCK_S, PPG_BLOCK_S = 2.0, 1.0
"""The longest interval is as long: a block without a QRS complex spans too little."""
WEAK_BLOCK_S, WEAK_TIMES = 2.5, (3.0, 6.0)
"""The longest interval of a rate is as long; and by how much the usual block may span more than
the narrowest."""
BREATH_UNEVENNESS = (3.0, 6.0)
"""The same of `BREATH_BLOCK_S`; a sigh is three times as deep as a breath."""
EDA_RANGE_MICROSIEMENS = (0.05, 60.0)
"""[7]_."""
EDA_SLOPE_MICROSIEMENS_PER_S, EDA_SLOPE_LEVELS_PER_S = (0.5, 10.0), 1.0
"""[7]_ has the larger limit, which nothing reaches at a wrist of 0 to 1.5 uS. Below 10 uS it is so
many times the level in a second, but not less than the smaller one."""
EDA_INVALID_NEAR_S = 5.0
"""[7]_: what is so close to something invalid is not valid either."""
EDA_FALL_S, EDA_BEFORE_FALL_S = 1.0, 15.0
EDA_FALL_SHARE, EDA_FALL_BELOW_SHARE = 0.35, 0.16
"""[6]_: half of a response is gone after 2 to 10 s; in 1 s it is at most 0.3 of what it rose by,
and of larger ones before it, which go on falling below it, 0.1 less in the next second."""
EDA_FALL_TIMES = 3.0
"""How much more than usual it falls: of what swings all the time, none is a touch."""
EDA_LEAST_MICROSIEMENS = (0.05, 0.1)
"""Good while responses of 0.05 uS stand out of noise, the largest limit that is usual [6]_; bad
where none below twice that does."""
SKIN_CELSIUS = (30.0, 40.0)
"""[7]_: what is colder or warmer is no skin below a sensor that is worn."""
BREATH_BAND_SHARE = (0.4, 0.8)
"""Power of 0.05 to 0.8 Hz to that of everything but the mean."""

LUMP_S = 3.0
"""In lumps of up to so long, devices send what they measure."""
SCR_HOLDS_S = 10.0
"""[6]_: half of a response is gone again after 2 to 10 s."""

MOST_HZ = 2000.0
"""What is faster is averaged to between half of it and this."""
RATES_HZ = {
    "ECG": (80.0, 50000.0),
    "PPG": (20.0, 50000.0),
    "GSR": (4.0, 50000.0),
    "Respiration": (4.0, 50000.0),
    "Accelerometer": (4.0, 50000.0),
}
"""Below it, what is to be found is not in the signal."""
WRONG_RATE = 0.1
"""Of a rate in another program's header: by what part it may be off and is still believed."""
