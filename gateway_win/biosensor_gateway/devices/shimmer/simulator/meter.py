"""Measures with all sensors of a virtual Shimmer that are on, a block at a time."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from biosensor_gateway.devices.shimmer.simulator.air import PRESSURE, TEMPERATURE, AirSensor
from biosensor_gateway.devices.shimmer.simulator.exg import (
    CHANNELS_16,
    CHANNELS_24,
    STATUS,
    ExgChips,
    voltages,
)
from biosensor_gateway.devices.shimmer.simulator.motion import (
    MotionSensor,
    Words,
    acting_on,
    tuples,
)
from biosensor_gateway.devices.shimmer.simulator.streaming import Block
from biosensor_gateway.simulation.wearer import Floats, Wearer

_Values = dict[str, Sequence[tuple[float, ...]]]


class UnitMeter:
    """The sensors of a unit during one stream.

    Parameters
    ----------
    channels
        Ids in packet order; those of sensors that the unit has not read 0.
    motion, air, exg
        What it has.
    wearer
    is_worn
        Asked once a block.
    """

    def __init__(
        self,
        channels: tuple[int, ...],
        motion: Sequence[MotionSensor],
        air: AirSensor,
        exg: ExgChips,
        wearer: Wearer,
        is_worn: Callable[[], bool],
    ) -> None:
        self._channels = channels
        self._motion = [each for each in motion if set(each.channels) <= set(channels)]
        self._air = air
        self._exg = exg
        self._wearer = wearer
        self._is_worn = is_worn

    def measure(self, t: Floats) -> Block:
        """Return what is measured at these times of the wearer [s]."""
        columns: dict[int, Words] = {}
        values: _Values = {}
        for sensor in self._motion:
            counts = sensor.counts(acting_on(self._wearer, sensor.data_name, t))
            columns.update(zip(sensor.channels, counts.T, strict=True))
            values[sensor.data_name] = tuples(sensor.values(counts))
        if {PRESSURE, TEMPERATURE} <= set(self._channels):
            self._measure_air(t, columns, values)
        if set(STATUS) & set(self._channels):
            self._measure_exg(t, columns, values)
        zeros = np.zeros(t.size, np.int64)
        chosen = [columns.get(channel, zeros).tolist() for channel in self._channels]
        return Block(list(zip(*chosen, strict=True)), values)

    def _measure_air(self, t: Floats, columns: dict[int, Words], values: _Values) -> None:
        raw_t, raw_p = self._air.raw(self._wearer, t)
        columns.update({TEMPERATURE: raw_t, PRESSURE: raw_p})
        pairs = zip(raw_t.tolist(), raw_p.tolist(), strict=True)
        airs = [self._air.air(each_t, each_p) for each_t, each_p in pairs]
        values["pressure"] = [(pascals,) for pascals, _ in airs]
        values["temp"] = [(degrees,) for _, degrees in airs]

    def _measure_exg(self, t: Floats, columns: dict[int, Words], values: _Values) -> None:
        worn, chips = self._is_worn(), self._exg
        signals = voltages(self._wearer, t, is_emg=chips.is_emg, worn=worn)
        leads: list[Floats] = []
        for chip in (0, 1):
            bits = 24 if CHANNELS_24[chip][0] in self._channels else 16
            sent = (CHANNELS_24 if bits == 24 else CHANNELS_16)[chip]
            columns[STATUS[chip]] = np.full(t.size, chips.status(chip, worn=worn))
            for channel, number in enumerate(sent):
                counts = chips.counts(chip, channel, signals[2 * chip + channel], bits)
                columns[number] = counts
                is_sent = number in self._channels
                microvolts = chips.microvolts(chip, channel, counts, bits)
                leads.append(microvolts if is_sent else np.full(t.size, np.nan))
        chosen = leads[:2] if chips.is_emg else [leads[0], leads[1], leads[3]]
        values["emg" if chips.is_emg else "ecg"] = tuples(np.stack(chosen, axis=1))
        if not chips.is_emg and chips.detects and set(STATUS) <= set(self._channels):
            values["quality"] = [self._quality(worn=worn)] * t.size

    def _quality(self, *, worn: bool) -> tuple[float, ...]:
        first, second = (self._exg.status(chip, worn=worn) for chip in (0, 1))
        # Right arm, left arm, left leg, chest.
        is_open = first & 2, first & 4, first & 1, second & 4
        electrodes = [float(not each) for each in is_open]
        return (float(not any(is_open)), *electrodes)
