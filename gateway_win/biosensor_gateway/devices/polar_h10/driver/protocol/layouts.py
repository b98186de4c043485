"""Reads data frames: ``measurement | timestamp of the last sample | frame type | samples``."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping

from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import Measurement
from biosensor_gateway.devices.polar_h10.driver.protocol.frames import (
    PPG_CHANNELS,
    Acceleration,
    Ecg,
    Frame,
    Header,
    MagneticField,
    Ppg,
    PulseInterval,
    PulseIntervals,
    Rejected,
    Rotation,
    Sample,
    expand,
)

_HEADER = struct.Struct("<BQB")
_MEASUREMENT_MASK = 0x3F
_G_PER_MILLI_G = 0.001

_Layout = Callable[[Header, bytes, float], Frame | None]


def measurement_of(data: bytes) -> int | None:
    """Tell whose samples a frame holds; None if it is empty."""
    return data[0] & _MEASUREMENT_MASK if data else None


def parse_frame(data: bytes, factors: Mapping[int, float]) -> Frame | Rejected:
    """Read a data frame; it is taken whole or not at all.

    Parameters
    ----------
    factors
        By measurement, what the device named when it was started: physical units
        (g, deg/s or gauss) a count of compressed frames; 1 where it named none.
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
    # 22-bit values in three bytes each.
    samples = expand(data, PPG_CHANNELS, 24)
    return None if samples is None else Ppg(header, tuple(samples))


def _compressed_ppg_of_two_leds(header: Header, data: bytes, factor: float) -> Frame | None:
    del factor
    # Behind the values of the photodiodes stand bits of status.
    samples = expand(data, 3, 24)
    return None if samples is None else Ppg(header, tuple(each[:2] for each in samples))


def _rotation(header: Header, data: bytes, factor: float) -> Frame | None:
    samples = expand(data, 3, 16)
    return None if samples is None else Rotation(header, tuple(samples), factor)


def _magnetic_field(header: Header, data: bytes, factor: float) -> Frame | None:
    samples = expand(data, 3, 16)
    return None if samples is None else MagneticField(header, tuple(samples), factor)


def _magnetic_field_with_status(header: Header, data: bytes, factor: float) -> Frame | None:
    # Counts of a thousandth gauss, and how well the sensor has calibrated itself.
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
