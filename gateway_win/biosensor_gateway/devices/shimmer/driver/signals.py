"""Makes streams of channels, and turns their values into units."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from biosensor_gateway.devices.shimmer.driver.adc import Floats
from biosensor_gateway.devices.shimmer.driver.calibration import (
    STANDARD_GRAVITY_MS2,
    Block,
    Kinematic,
)
from biosensor_gateway.devices.shimmer.driver.channels import Channel, Layout
from biosensor_gateway.devices.shimmer.driver.exg import Exg, Use, microvolts
from biosensor_gateway.devices.shimmer.driver.pressure import Compensation


class Sensor(NamedTuple):
    """A sensor that can be switched on.

    Attributes
    ----------
    mask
        Its bits of the sensor mask.
    channels
        What it adds to each packet.
    """

    mask: int
    channels: frozenset[Channel]


class Motion(NamedTuple):
    """A motion sensor of three axes.

    Attributes
    ----------
    mask
        Its bit of the sensor mask.
    axes
        Channels of X, Y, Z.
    block
        Where its calibration is.
    units
        How many of the calibration's units are one of the stream's.
    """

    mask: int
    axes: tuple[Channel, Channel, Channel]
    block: Block
    units: float = 1.0


MOTION = {
    "acc_low_noise": Motion(
        0x000080,
        (Channel.LN_ACCEL_X, Channel.LN_ACCEL_Y, Channel.LN_ACCEL_Z),
        Block.LN_ACCEL,
        STANDARD_GRAVITY_MS2,
    ),
    "acc_wide_range": Motion(
        0x001000,
        (Channel.WR_ACCEL_X, Channel.WR_ACCEL_Y, Channel.WR_ACCEL_Z),
        Block.WR_ACCEL,
        STANDARD_GRAVITY_MS2,
    ),
    "gyro": Motion(0x000040, (Channel.GYRO_X, Channel.GYRO_Y, Channel.GYRO_Z), Block.GYRO),
    "mag": Motion(0x000020, (Channel.MAG_X, Channel.MAG_Y, Channel.MAG_Z), Block.MAG),
}
_AIR = (Channel.TEMPERATURE, Channel.PRESSURE)
_EXG = {
    24: (
        (Channel.EXG1_STATUS, Channel.EXG1_CH1_24, Channel.EXG1_CH2_24),
        (Channel.EXG2_STATUS, Channel.EXG2_CH1_24, Channel.EXG2_CH2_24),
    ),
    16: (
        (Channel.EXG1_STATUS, Channel.EXG1_CH1_16, Channel.EXG1_CH2_16),
        (Channel.EXG2_STATUS, Channel.EXG2_CH1_16, Channel.EXG2_CH2_16),
    ),
}
_EXG_MASKS = {24: (0x000010, 0x000008), 16: (0x100000, 0x080000)}
SENSORS = (*MOTION, "pressure", *Use)
"""What can be switched on, by the data name of its (first) stream."""


def sensor(name: str, bits: int) -> Sensor:
    """Return a sensor of `SENSORS`; an ExG of so many bits, 16 or 24."""
    if name in MOTION:
        return Sensor(MOTION[name].mask, frozenset(MOTION[name].axes))
    if name == "pressure":
        return Sensor(0x040000, frozenset(_AIR))
    # EMG needs one of the two chips.
    chips = 2 if name == Use.ECG else 1
    on = [each for chip in _EXG[bits][:chips] for each in chip]
    return Sensor(sum(_EXG_MASKS[bits][:chips]), frozenset(on))


@dataclass(frozen=True, slots=True)
class Signal:
    """A stream that a packet has a sample of.

    Attributes
    ----------
    at
        Where its channels are within a packet.
    convert
        Turns their values, shape (n, channels), into samples of the stream.
    """

    data_name: str
    at: tuple[int, ...]
    convert: Callable[[Floats], Floats]


def motion_on(layout: Layout) -> list[str]:
    """Return the motion sensors of which packets have values, by data name."""
    return [name for name, each in MOTION.items() if set(each.axes) <= set(layout.channels)]


def has_air(layout: Layout) -> bool:
    """Whether packets have pressure and temperature."""
    return set(_AIR) <= set(layout.channels)


def has_exg(layout: Layout) -> bool:
    """Whether packets have values of the first ExG chip."""
    return _bits(layout, chip=0) is not None


def motion_signals(layout: Layout, calibrations: Iterable[tuple[str, Kinematic]]) -> list[Signal]:
    """Return the streams of motion sensors with their calibrations, by data name."""

    def convert(calibration: Kinematic, units: float, raw: Floats) -> Floats:
        return calibration.apply(raw) / units

    return [
        Signal(name, _places(layout, each.axes), partial(convert, calibration, each.units))
        for name, calibration in calibrations
        for each in [MOTION[name]]
    ]


def air_signals(layout: Layout, compensate: Compensation) -> list[Signal]:
    """Return the streams of pressure and temperature."""
    at = _places(layout, _AIR)
    return [
        Signal("pressure", at, lambda raw: compensate(raw[:, 0], raw[:, 1])[0]),
        Signal("temp", at, lambda raw: compensate(raw[:, 0], raw[:, 1])[1]),
    ]


def exg_signal(layout: Layout, exg: Exg) -> Signal:
    """Return the stream of the ExG chips; leads of a chip that is off have no value."""
    leads = [(0, 1), (0, 2)] if exg.use is Use.EMG else [(0, 1), (0, 2), (1, 2)]
    scales: list[float] = []
    at: list[int] = []
    for chip, channel in leads:
        bits = _bits(layout, chip)
        found = _EXG[bits or 24][chip][channel]
        at.append(layout.index(found) if bits else layout.index(Channel.EXG1_STATUS))
        scales.append(float(microvolts(1, exg.gain(chip, channel), bits)) if bits else np.nan)
    return Signal(exg.use, tuple(at), lambda raw: raw * np.array(scales))


def status_places(layout: Layout) -> tuple[int, int] | None:
    """Return where the status of both chips is; None if one of them is off."""
    wanted = (Channel.EXG1_STATUS, Channel.EXG2_STATUS)
    if not set(wanted) <= set(layout.channels):
        return None
    first, second = _places(layout, wanted)
    return first, second


def _bits(layout: Layout, chip: int) -> int | None:
    for bits, chips in _EXG.items():
        if set(chips[chip]) <= set(layout.channels):
            return bits
    return None


def _places(layout: Layout, channels: Sequence[Channel]) -> tuple[int, ...]:
    return tuple(layout.index(each) for each in channels)
