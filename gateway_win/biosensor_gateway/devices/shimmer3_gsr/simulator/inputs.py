"""Computes what a Shimmer3's converter reads from its wearer, a block of samples at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from biosensor_gateway.devices.shimmer3_gsr.simulator.gsr import GsrAmplifier
from biosensor_gateway.simulation.wearer import Floats, Wearer

BATTERY, PPG, GSR = 0x03, 0x12, 0x1C
_LN_ACCEL = (0x00, 0x01, 0x02)
_FULL_SCALE_COUNTS, _FULL_SCALE_MV = 4095, 3000.0
_PULSE_LEVEL_MV, _PULSE_SWING_MV = 1500.0, 400.0
# A probe that sees no finger, and one without power.
_DARK_MV, _UNPOWERED_MV = 900.0, 6.0
_ACCEL_OFFSET, _ACCEL_COUNTS_PER_MS2, _GRAVITY_MS2 = 2253, 92, 9.80665
# From the axes of the case to those of the chip.
_MOUNTING = np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1]], np.float64)


def ppg_mv(counts: int) -> float:
    """Return the voltage of the pulse probe that a reading stands for [mV]."""
    return counts * _FULL_SCALE_MV / _FULL_SCALE_COUNTS


@dataclass(frozen=True)
class Conditions:
    """What a block is measured under.

    Attributes
    ----------
    worn
        Electrodes and probe are on the skin.
    probe_powered
        The expansion power is on.
    battery_counts
        Reading of the battery's voltage.
    """

    worn: bool
    probe_powered: bool
    battery_counts: int


def read(
    channels: tuple[int, ...],
    wearer: Wearer,
    t: Floats,
    conditions: Conditions,
    amplifier: GsrAmplifier,
) -> list[tuple[int, ...]]:
    """Return the readings of a block, for each sample a count for each channel.

    Sensors of which the wearer has no model (gyroscope, magnetometer, pressure, ExG,
    free inputs) read 0.

    Parameters
    ----------
    channels
        Ids in packet order.
    t
        When the samples are taken, in the wearer's time [s].
    amplifier
        The one of all blocks of a stream: it remembers its range.
    """
    columns: Mapping[int, Callable[[], list[int]]] = {
        BATTERY: lambda: [conditions.battery_counts] * t.size,
        PPG: lambda: _counts(_probe_mv(wearer, t, conditions)),
        GSR: lambda: amplifier.measure(_skin(wearer, t, conditions).tolist()),
    }
    zeros = [0] * t.size
    read_columns = {
        channel: columns[channel]() if channel in columns else zeros for channel in channels
    }
    if set(_LN_ACCEL) <= set(channels):
        read_columns.update(zip(_LN_ACCEL, _acceleration(wearer, t), strict=True))
    return list(zip(*(read_columns[channel] for channel in channels), strict=True))


def _skin(wearer: Wearer, t: Floats, conditions: Conditions) -> Floats:
    return wearer.skin_conductance_us(t) if conditions.worn else np.zeros(t.shape)


def _probe_mv(wearer: Wearer, t: Floats, conditions: Conditions) -> Floats:
    if not conditions.probe_powered:
        return _UNPOWERED_MV + wearer.noise(t, 1.0, "unpowered probe")
    if not conditions.worn:
        return np.full(t.shape, _DARK_MV)
    return _PULSE_LEVEL_MV + _PULSE_SWING_MV * wearer.pulse(t)


def _counts(millivolts: Floats) -> list[int]:
    scaled = np.rint(millivolts / _FULL_SCALE_MV * _FULL_SCALE_COUNTS)
    return [int(count) for count in np.clip(scaled, 0, _FULL_SCALE_COUNTS)]


def _acceleration(wearer: Wearer, t: Floats) -> list[list[int]]:
    on_chip = wearer.acceleration_g(t) @ _MOUNTING.T * _GRAVITY_MS2
    counts = np.rint(_ACCEL_OFFSET + _ACCEL_COUNTS_PER_MS2 * on_chip).astype(np.int64)
    return [[int(count) for count in axis] for axis in counts.T]
