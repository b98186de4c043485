"""Computes what a Shimmer3's converter reads from its wearer, a block of samples at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isnan, nan

import numpy as np

from biosensor_gateway.devices.shimmer.simulator.streaming import Block
from biosensor_gateway.devices.shimmer3_gsr.simulator.gsr import (
    AUTO_RANGE,
    GsrAmplifier,
    conductance_us,
)
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


class GsrMeter:
    """The sensors of a GSR+ unit during one stream.

    Parameters
    ----------
    channels
        Ids in packet order.
    setting
        Of the range: 0 to 3 for a fixed resistor, 4 for auto-range.
    divider
        Ticks between two samples.
    wearer
    conditions
        Asked once a block.
    """

    def __init__(
        self,
        channels: tuple[int, ...],
        setting: int,
        divider: int,
        wearer: Wearer,
        conditions: Callable[[], Conditions],
    ) -> None:
        self._channels = channels
        self._setting = setting
        self._wearer = wearer
        self._conditions = conditions
        self._amplifier = GsrAmplifier(setting, divider)

    def measure(self, t: Floats) -> Block:
        """Return what is measured at these times of the wearer [s]."""
        rows = read(self._channels, self._wearer, t, self._conditions(), self._amplifier)
        values: dict[str, Sequence[tuple[float, ...]]] = {}
        if GSR in self._channels:
            raw = [row[self._channels.index(GSR)] for row in rows]
            conductances = [conductance_us(each, self._setting) for each in raw]
            values["gsr"] = [(each,) for each in conductances]
            values["quality"] = [
                (float(not isnan(us)), float(self._range_of(each)), nan)
                for each, us in zip(raw, conductances, strict=True)
            ]
        if PPG in self._channels:
            at = self._channels.index(PPG)
            values["ppg"] = [(ppg_mv(row[at]),) for row in rows]
        return Block(rows, values)

    def _range_of(self, raw: int) -> int:
        return raw >> 14 if self._setting == AUTO_RANGE else self._setting


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
