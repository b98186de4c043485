"""A virtual Shimmer3 GSR+.

::

    with World() as world, SimulatedShimmer3(world) as device:
        serial.serial_for_url(device.port, 115200)
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isnan, nan
from types import MappingProxyType

import numpy as np

from biosensor_gateway.devices.shimmer.simulator import EXPECTED as ANY_SHIMMER
from biosensor_gateway.devices.shimmer.simulator.device import SimulatedShimmer
from biosensor_gateway.devices.shimmer.simulator.sampler import Block, Meter
from biosensor_gateway.devices.shimmer.simulator.wire import Memory
from biosensor_gateway.simulation.virtual_device import Filled
from biosensor_gateway.simulation.wearer import Floats, Wearer

EXPECTED = replace(
    ANY_SHIMMER,
    without_contact=("gsr",),
    # The heart rate is computed from the pulse wave.
    by_agent=frozenset({"hr", "quality"}),
)

BATTERY, PPG, GSR = 0x03, 0x12, 0x1C
_LN_ACCEL = (0x00, 0x01, 0x02)
_FULL_SCALE_MV = 3000.0
_PULSE_LEVEL_MV, _PULSE_SWING_MV = 1500.0, 400.0
# Voltages of a probe without a finger, and of one without power.
_DARK_MV, _UNPOWERED_MV = 900.0, 6.0
_ACCEL_OFFSET, _ACCEL_COUNTS_PER_MS2, _GRAVITY_MS2 = 2253, 92, 9.80665
# Converts the axes of the case to those of the chip.
_MOUNTING = np.array([[0, -1, 0], [-1, 0, 0], [0, 0, -1]], np.float64)

# A GSR+ board has a non-inverting amplifier with 0.5 V across the skin, ``V = 0.5 V * (1 + Rf *
# G)``, and a 12-bit ADC for 3 V.
AUTO_RANGE = 4
_FEEDBACK_KOHM = (40.2, 287.0, 1000.0, 3300.0)
# ADC counts at 0.5 V.
_OPEN_COUNTS = 682.5
_FULL_SCALE_COUNTS = 4095
# Counts above which the next smaller, or below which the next larger resistor is used.
_SWITCH_UP = (_FULL_SCALE_COUNTS + 1, 3960, 3700, 3930)
_SWITCH_DOWN = (1120, 1490, 1630, -1)
_HOLD_TICKS = 2621
_SMALLEST_KOHM = 8.0
_FIXED_KOHM = ((8.0, 63.0), (63.0, 220.0), (220.0, 680.0), (680.0, 4700.0))


def counts_in(gsr_range: int, microsiemens: float) -> int:
    """Return the ADC counts of a conductance with one of the resistors, 0 to 3."""
    gain = 1 + microsiemens * _FEEDBACK_KOHM[gsr_range] / 1000
    return min(int(_OPEN_COUNTS * gain), _FULL_SCALE_COUNTS)


def conductance_us(raw: int, setting: int) -> float:
    """Return the conductance of a raw word [uS]; NaN for open electrodes.

    Parameters
    ----------
    raw
        Resistor in the upper two bits, ADC counts in the lower twelve.
    setting
        0 to 3 for a fixed resistor, which overrides the word's bits; 4 for auto-range.
    """
    gsr_range, counts = raw >> 14 if setting == AUTO_RANGE else setting, raw & 0xFFF
    if counts <= (683 if gsr_range == 3 else 682):
        return nan
    kohm = _FEEDBACK_KOHM[gsr_range] / (counts / _OPEN_COUNTS - 1)
    if setting == AUTO_RANGE:
        return 1000 / max(kohm, _SMALLEST_KOHM)
    low, high = _FIXED_KOHM[gsr_range]
    return 1000 / min(max(kohm, low), high)


class GsrAmplifier:
    """The amplifier and its range over time.

    Parameters
    ----------
    setting
        0 to 3 for a fixed resistor, 4 for auto-range, which starts with the smallest.
    divider
        Ticks between two samples.
    """

    def __init__(self, setting: int, divider: int) -> None:
        self._auto = setting == AUTO_RANGE
        self._range = 0 if self._auto else setting
        self._held_samples = _HOLD_TICKS // divider
        self._to_hold = 0
        self._last_good = 0

    def measure(self, microsiemens: Iterable[float]) -> list[int]:
        """Return the raw words of conductances, sample by sample."""
        return [self._sample(value) for value in microsiemens]

    def _sample(self, microsiemens: float) -> int:
        if self._to_hold:
            self._to_hold -= 1
            return self._last_good
        counts = counts_in(self._range, microsiemens)
        self._last_good = self._range << 14 | counts
        if self._auto:
            self._switch(counts)
        return self._last_good

    def _switch(self, counts: int) -> None:
        """Switch the resistor if needed; the last value is repeated while the amplifier settles."""
        step = (counts < _SWITCH_DOWN[self._range]) - (counts > _SWITCH_UP[self._range])
        if step:
            self._range += step
            self._to_hold = self._held_samples


def ppg_mv(counts: int) -> float:
    """Return the voltage of the pulse probe [mV] from ADC counts."""
    return counts * _FULL_SCALE_MV / _FULL_SCALE_COUNTS


@dataclass(frozen=True)
class Conditions:
    """The conditions of a block's measurement."""

    worn: bool  # Whether electrodes and probe are on the skin.
    probe_powered: bool  # Whether the expansion power is on.
    battery_counts: int  # Battery voltage in ADC counts.


class GsrMeter:
    """The sensors of a GSR+ unit during one stream.

    Parameters
    ----------
    channels
        Channel ids in packet order.
    setting
        Range setting: 0 to 3 for a fixed resistor, 4 for auto-range.
    divider
        Ticks between two samples.
    conditions
        Called once per block.
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
        """Return the measurements at these times of the wearer [s]."""
        rows = _readings(self._channels, self._wearer, t, self._conditions(), self._amplifier)
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


def _readings(
    channels: tuple[int, ...],
    wearer: Wearer,
    t: Floats,
    conditions: Conditions,
    amplifier: GsrAmplifier,
) -> list[tuple[int, ...]]:
    """Return the counts of a block, one per channel for each sample.

    Sensors without a model in the wearer (gyroscope, magnetometer, pressure, ExG, free inputs)
    read 0.

    Parameters
    ----------
    channels
        Channel ids in packet order.
    t
        Times of the samples in the wearer's time [s].
    amplifier
        Amplifier of the stream, which keeps its range between blocks.
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


class SimulatedShimmer3(SimulatedShimmer):
    """A virtual Shimmer3 GSR+.

    Its `truth` contains ``gsr`` [uS], NaN while the electrodes are open; ``ppg`` [mV]; ``bat``
    [percent] of each answer about the battery; and ``quality`` at each change, with NaN for the
    pulse, which only a host detects. The heart rate is the wearer's. The parameters are those of
    `SimulatedShimmer`.
    """

    sensor = "shimmer3_gsr"
    expected = EXPECTED
    filled = MappingProxyType({"hr": Filled(7, "it takes five heart beats")})
    memory = Memory()

    def _meter(self, channels: tuple[int, ...]) -> Meter:
        setting, divider = self._flash.gsr_range, self._flash.divider
        return GsrMeter(channels, setting, divider, self.wearer, self._conditions)

    def _conditions(self) -> Conditions:
        return Conditions(self._worn, bool(self._flash.expansion_power), self.battery_counts())
