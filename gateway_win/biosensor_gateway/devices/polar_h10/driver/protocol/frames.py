"""Parses data frames."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum, unique
from math import nan

from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import Measurement

DATA = "fb005c82-02e7-f387-1cad-8acd2d8df0c8"

_COMPRESSED = 0x80
_MICROTESLA_PER_GAUSS = 100.0
PPG_CHANNELS = 4

# A compressed frame consists of a reference sample, in whole bytes per channel, and blocks of
# ``bits | count | payload``: `count` samples with one difference per channel, each `bits` wide,
# packed from the lowest bit on and padded to a whole byte.
Sample = tuple[int, ...]

MAX_BITS = 32
"""Larger than any difference of two 24-bit values."""


def expand(data: bytes, channels: int, resolution_bits: int) -> list[Sample] | None:
    """Return the samples of a compressed frame; None if it is truncated or damaged.

    Parameters
    ----------
    data
        Everything after the frame's header.
    resolution_bits
        Resolution of the reference sample.

    Returns
    -------
    list of tuple of int
        One value per channel; up to 255 samples for every two bytes.
    """
    width = -(-resolution_bits // 8)
    position = width * channels
    if len(data) < position:
        return None
    sample = tuple(
        int.from_bytes(data[at : at + width], "little", signed=True)
        for at in range(0, position, width)
    )
    samples = [sample]
    while position < len(data):
        header = data[position : position + 2]
        if len(header) < 2 or header[0] > MAX_BITS:
            return None
        bits, count = header
        end = position + 2 + -(-bits * count * channels // 8)
        if end > len(data):
            return None
        for deltas in _deltas(data[position + 2 : end], bits, count, channels):
            sample = tuple(value + delta for value, delta in zip(sample, deltas, strict=True))
            samples.append(sample)
        position = end
    return samples


def _deltas(payload: bytes, bits: int, count: int, channels: int) -> Iterator[list[int]]:
    number = int.from_bytes(payload, "little")
    mask, sign = (1 << bits) - 1, (1 << bits) >> 1
    for first in range(0, count * channels, channels):
        fields = [number >> (index * bits) & mask for index in range(first, first + channels)]
        # Flipping the sign bit and subtracting it extends the sign; zero bits mean zero.
        yield [(field ^ sign) - sign for field in fields]


@dataclass(frozen=True, slots=True)
class Header:
    """The header of a frame."""

    measurement: int  # One of `Measurement`, or an unknown number.
    # Device time of the last sample [ns since 2000-01-01, if the clock was ever set].
    timestamp_ns: int
    frame_type: int  # Layout of the samples; compressed from 0x80 on.

    @property
    def compressed(self) -> bool:
        """Whether the samples are delta-compressed."""
        return self.frame_type >= _COMPRESSED


@dataclass(frozen=True, slots=True)
class Ecg:
    """Electrocardiogram [uV]."""

    header: Header
    microvolts: tuple[int, ...]

    @property
    def samples(self) -> list[list[float]]:
        """One channel [uV]."""
        return [[value] for value in self.microvolts]


@dataclass(frozen=True, slots=True)
class Acceleration:
    """Acceleration, x y z [counts].

    Polar's SDK truncates compressed values to whole mg; here they keep their resolution.
    """

    header: Header
    counts: tuple[Sample, ...]
    g_per_count: float

    @property
    def samples(self) -> list[list[float]]:
        """Three channels [g]."""
        return _scaled(self.counts, self.g_per_count)


@dataclass(frozen=True, slots=True)
class Rotation:
    """Angular velocity, x y z [counts]."""

    header: Header
    counts: tuple[Sample, ...]
    degrees_per_s_per_count: float

    @property
    def samples(self) -> list[list[float]]:
        """Three channels [deg/s]."""
        return _scaled(self.counts, self.degrees_per_s_per_count)


@dataclass(frozen=True, slots=True)
class MagneticField:
    """Magnetic flux density, x y z [counts]."""

    header: Header
    counts: tuple[Sample, ...]
    gauss_per_count: float

    @property
    def samples(self) -> list[list[float]]:
        """Three channels [uT]."""
        return _scaled(self.counts, self.gauss_per_count * _MICROTESLA_PER_GAUSS)


@dataclass(frozen=True, slots=True)
class Ppg:
    """Photoplethysmogram [counts]: three LEDs and the ambient light, or only two LEDs."""

    header: Header
    counts: tuple[Sample, ...]

    @property
    def samples(self) -> list[list[float]]:
        """Four channels [counts]; NaN for those that the device does not have."""
        return [[*each, *(nan,) * (PPG_CHANNELS - len(each))] for each in self.counts]


@dataclass(frozen=True, slots=True)
class PulseInterval:
    """Interval between two pulse waves, measured by an optical sensor."""

    bpm: int
    # interval_ms, error_ms: the interval and the device's estimate of its error.
    interval_ms: int
    error_ms: int
    moved: bool  # Whether the device flags the interval as invalid because of movement.
    contact: bool | None  # Whether there is skin contact; None if not reported.

    @property
    def is_valid(self) -> bool:
        """Whether the device considers it valid."""
        return not self.moved and self.contact is not False


@dataclass(frozen=True, slots=True)
class PulseIntervals:
    """Intervals between pulse waves, oldest first."""

    header: Header
    intervals: tuple[PulseInterval, ...]


RegularFrame = Ecg | Acceleration | Rotation | MagneticField | Ppg
"""Frames of samples at a constant rate."""
Frame = RegularFrame | PulseIntervals


@unique
class Rejected(Enum):
    """Why a frame cannot be parsed."""

    DAMAGED = "damaged"
    """It is truncated, or its lengths do not match."""
    UNKNOWN = "unknown"
    """Its layout is unknown."""


def _scaled(counts: tuple[Sample, ...], unit: float) -> list[list[float]]:
    return [[count * unit for count in sample] for sample in counts]


_HEADER = struct.Struct("<BQB")
_MEASUREMENT_MASK = 0x3F
_G_PER_MILLI_G = 0.001

_Layout = Callable[[Header, bytes, float], Frame | None]


def measurement_of(data: bytes) -> int | None:
    """Return the measurement of a frame; None if it is empty."""
    return data[0] & _MEASUREMENT_MASK if data else None


def parse_frame(data: bytes, factors: Mapping[int, float]) -> Frame | Rejected:
    """Parse a data frame, completely or not at all.

    Parameters
    ----------
    factors
        Physical units (g, deg/s or gauss) per count of compressed frames, by measurement, as
        reported at the start; 1 if not reported.
    """
    if len(data) < _HEADER.size:
        return Rejected.DAMAGED
    measurement, timestamp_ns, frame_type = _HEADER.unpack_from(data)
    header = Header(measurement & _MEASUREMENT_MASK, timestamp_ns, frame_type)
    parse = _LAYOUTS.get((header.measurement, frame_type))
    if parse is None:
        return Rejected.UNKNOWN
    factor = factors.get(header.measurement, 1.0)
    return parse(header, data[_HEADER.size :], factor) or Rejected.DAMAGED


def _ecg(header: Header, data: bytes, factor: float) -> Frame | None:
    del factor
    samples = _integers(data, 3, 1)
    return None if samples is None else Ecg(header, tuple(sample[0] for sample in samples))


def _acceleration(width: int) -> _Layout:
    def parse(header: Header, data: bytes, factor: float) -> Frame | None:
        del factor
        samples = _integers(data, width, 3)
        return None if samples is None else Acceleration(header, samples, _G_PER_MILLI_G)

    return parse


def _compressed_acceleration(unit_g: float) -> _Layout:
    def parse(header: Header, data: bytes, factor: float) -> Frame | None:
        samples = expand(data, 3, 16)
        return None if samples is None else Acceleration(header, tuple(samples), factor * unit_g)

    return parse


def _ppg(header: Header, data: bytes, factor: float) -> Frame | None:
    del factor
    samples = _integers(data, 3, 4)
    return None if samples is None else Ppg(header, samples)


def _compressed_ppg(header: Header, data: bytes, factor: float) -> Frame | None:
    del factor
    # 22-bit values in three bytes.
    samples = expand(data, PPG_CHANNELS, 24)
    return None if samples is None else Ppg(header, tuple(samples))


def _compressed_ppg_of_two_leds(header: Header, data: bytes, factor: float) -> Frame | None:
    del factor
    # Status bits follow the values of the photodiodes.
    samples = expand(data, 3, 24)
    return None if samples is None else Ppg(header, tuple(each[:2] for each in samples))


def _rotation(header: Header, data: bytes, factor: float) -> Frame | None:
    samples = expand(data, 3, 16)
    return None if samples is None else Rotation(header, tuple(samples), factor)


def _magnetic_field(header: Header, data: bytes, factor: float) -> Frame | None:
    samples = expand(data, 3, 16)
    return None if samples is None else MagneticField(header, tuple(samples), factor)


def _magnetic_field_with_status(header: Header, data: bytes, factor: float) -> Frame | None:
    # Counts of a thousandth gauss, and the sensor's calibration status.
    samples = expand(data, 4, 16)
    if samples is None:
        return None
    return MagneticField(header, tuple(each[:3] for each in samples), factor / 1000)


_PULSE_INTERVAL = struct.Struct("<BHHB")


def _pulse_intervals(header: Header, data: bytes, factor: float) -> Frame | None:
    del factor
    if len(data) % _PULSE_INTERVAL.size:
        return None
    return PulseIntervals(header, tuple(_each_interval(data)))


def _each_interval(data: bytes) -> Iterator[PulseInterval]:
    for bpm, interval_ms, error_ms, flags in _PULSE_INTERVAL.iter_unpack(data):
        contact = bool(flags >> 1 & 1) if flags >> 2 & 1 else None
        yield PulseInterval(bpm, interval_ms, error_ms, bool(flags & 1), contact)


def _integers(data: bytes, width: int, channels: int) -> tuple[Sample, ...] | None:
    size = width * channels
    if len(data) % size:
        return None
    values = [
        int.from_bytes(data[at : at + width], "little", signed=True)
        for at in range(0, len(data), width)
    ]
    return tuple(tuple(values[at : at + channels]) for at in range(0, len(values), channels))


_LAYOUTS: dict[tuple[int, int], _Layout] = {
    (Measurement.ECG, 0x00): _ecg,
    (Measurement.ACCELERATION, 0x00): _acceleration(1),
    (Measurement.ACCELERATION, 0x01): _acceleration(2),
    (Measurement.ACCELERATION, 0x02): _acceleration(3),
    (Measurement.ACCELERATION, 0x80): _compressed_acceleration(1.0),
    (Measurement.ACCELERATION, 0x81): _compressed_acceleration(_G_PER_MILLI_G),
    (Measurement.PPG, 0x00): _ppg,
    (Measurement.PPG, 0x80): _compressed_ppg,
    (Measurement.PPG, 0x8D): _compressed_ppg_of_two_leds,
    (Measurement.PULSE_INTERVALS, 0x00): _pulse_intervals,
    (Measurement.GYROSCOPE, 0x80): _rotation,
    (Measurement.MAGNETOMETER, 0x80): _magnetic_field,
    (Measurement.MAGNETOMETER, 0x81): _magnetic_field_with_status,
}
