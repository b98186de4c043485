"""Plausible numbers: of JSON, and the ranges of physiological and device values.

The ranges are wide: they include every value that a person has ever had, and those of an electrode
that has come off or touches another one. A value outside is a wrapped counter, a misread field or
a transmission error.
"""

from __future__ import annotations

from sys import float_info

HEART_RATE_BPM = (10.0, 300.0)
"""The heart's ventricles beat at most 300 times a minute; who sends 0 has found no beat."""
BEAT_INTERVAL_S = (0.1, 64.0)
"""From half the shortest interval to the longest that a 16-bit field of 1/1024 s can hold."""
BEAT_UNCERTAINTY_S = (0.0, 64.0)
VARIABILITY_MS = (0.0, 32_000.0)
"""A standard deviation is at most half of the range of the intervals."""
BREATHING_RATE_BPM = (0.0, 200.0)
"""Even the fastest panting stays below this rate."""
TEMPERATURE_C = (-50.0, 100.0)
PERCENT = (0.0, 100.0)
SATURATION_PERCENT = (1.0, 100.0)
"""Who sends 0 has found no blood."""
CONDUCTANCE_US = (-100.0, 10_000.0)
"""An amplifier's offset may give negative values, and touching electrodes give thousands."""
BIOPOTENTIAL_UV = (-1e6, 1e6)
"""The potential of a metal on the skin is below a volt."""
BAND_POWER_UV2_PER_HZ = (0.0, 1e9)
RESISTANCE_OHM = (0.0, 1e9)
PULSE_PROBE_MV = (-5000.0, 5000.0)
"""No converter in a wearable has a higher supply voltage."""
FORCE_N = (-100.0, 200.0)
"""A belt is made for 50 N and tears above 200 N."""
ACCELERATION_G = (-64.0, 64.0)
"""Twice the widest range of the chips in wearables."""
ROTATION_DEG_S = (-8000.0, 8000.0)
MAGNETIC_FIELD_UT = (-20_000.0, 20_000.0)
"""Twice the widest range, too; a magnet close to the sensor saturates it."""
ANGLE_DEG = (-360.0, 360.0)
ACTIVITY_G = (0.0, 64.0)
SPEED_M_S = (0.0, 50.0)
"""180 km/h: no cyclist and no runner is faster on a road."""
CADENCE_RPM = (0.0, 300.0)
"""Track cyclists reach 200 revolutions, runners 300 steps."""
POWER_W = (-1000.0, 5000.0)
"""The best sprinters reach 2500 W; a meter with an offset gives negative values."""
SIGNAL_STRENGTH_DBM = (-127.0, 20.0)
"""The range of Bluetooth's RSSI; its value 127 means unknown."""
PRESSURE_PA = (0.0, 1e7)


def finite(number: object) -> float | None:
    """Return a number of JSON as float; None if it is another thing, or no float can hold it."""
    if isinstance(number, bool) or not isinstance(number, int | float):
        return None
    # Compared before it is converted: the integers of JSON have no largest, and NaN is not below.
    return float(number) if abs(number) <= float_info.max else None
