"""Bounds of what a body, a sensor on it and its radio can show, for declarations.

They are wide: nothing that a person has ever shown is outside, nor what an electrode shows that
has come off or touches another one. What is outside is a count that stepped back, a field that was
misread, or damage on the way.
"""

from __future__ import annotations

HEART_RATE_BPM = (0.0, 300.0)
"""A chamber of the heart conducts no more than 300 beats a minute."""
BEAT_INTERVAL_S = (0.1, 64.0)
"""From twice the fastest rate to the longest that a field of 1/1024 s can tell."""
BEAT_UNCERTAINTY_S = (0.0, 64.0)
VARIABILITY_MS = (0.0, 32_000.0)
"""A standard deviation is at most half of the span of the intervals."""
BREATHING_RATE_BPM = (0.0, 200.0)
"""Who pants as fast as possible stays below it."""
TEMPERATURE_C = (-50.0, 100.0)
SATURATION_PERCENT = PERCENT = (0.0, 100.0)
CONDUCTANCE_US = (-100.0, 10_000.0)
"""Below zero by offset of an amplifier; electrodes that touch each other come to thousands."""
BIOPOTENTIAL_UV = (-1e6, 1e6)
"""The potential of a metal on the skin is below a volt."""
BAND_POWER_UV2_PER_HZ = (0.0, 1e9)
RESISTANCE_OHM = (0.0, 1e9)
PULSE_PROBE_MV = (-5000.0, 5000.0)
"""No converter of a wearable has a wider supply."""
FORCE_N = (-100.0, 200.0)
"""A belt is made for 50 N; beyond 200 it tears."""
ACCELERATION_G = (-64.0, 64.0)
"""Twice the widest range of the chips in wearables."""
ROTATION_DEG_S = (-8000.0, 8000.0)
MAGNETIC_FIELD_UT = (-20_000.0, 20_000.0)
"""The same; a magnet beside the sensor saturates it."""
ANGLE_DEG = (-360.0, 360.0)
ACTIVITY_G = (0.0, 64.0)
SPEED_M_S = (0.0, 50.0)
"""180 km/h: no cyclist and no runner is faster on a road."""
CADENCE_RPM = (0.0, 300.0)
"""Track sprinters come to 200, runners to 300 steps."""
POWER_W = (-1000.0, 5000.0)
"""The best sprinters come to 2500 W; a meter with an offset is below zero."""
SIGNAL_STRENGTH_DBM = (-127.0, 20.0)
"""What Bluetooth can tell; 127 means that it is not known."""
PRESSURE_PA = (0.0, 1e7)
