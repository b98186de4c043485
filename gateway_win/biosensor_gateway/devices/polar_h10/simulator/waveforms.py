"""Computes the PMD service's regular measurements, from the wearer's signals to frames."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from biosensor_gateway.devices.polar_h10.simulator import pmd
from biosensor_gateway.devices.polar_h10.simulator.pmd import Integers, Measurement, Setting
from biosensor_gateway.devices.polar_h10.simulator.products import Product
from biosensor_gateway.simulation.wearer import Floats, Wearer

_ECG_LIMIT_UV = 20_000
_OPEN_ELECTRODES_UV = 30.0
_INT16_LIMIT = 0x7FFF
# Mean level and pulse amplitude of three LEDs and the ambient light.
_PPG_LEVELS = np.array([-520_000.0, -485_000.0, -477_000.0, -640_000.0])
_PPG_PULSE = np.array([9_000.0, 7_000.0, 8_000.0, 0.0])
_PPG_NOISE = 60.0
# Rotation of the limb at rest, and the earth's magnetic field there.
_TURNS_DEG_S = 2.0
_FIELD_GAUSS = np.array([0.21, -0.06, 0.43])
_FIELD_NOISE_GAUSS = 0.004
_MICROTESLA_PER_GAUSS = 100.0
# A compressed sample usually takes at most half of its raw size.
_COMPRESSION = 2


@dataclass(frozen=True)
class Waveform:
    """One measurement with its settings.

    Attributes
    ----------
    data_name
        Data name in the truth.
    rate_hz
        Nominal rate.
    sample_bytes
        Usual size of a sample in a frame.
    unit
        Size of one count in the declared unit.
    counts
        Returns counts, shape (n, channels), from the wearer's times [s] and whether the device is
        worn.
    frame
        Returns a frame from the time of the last sample [ns] and the counts.
    """

    data_name: str
    rate_hz: int
    sample_bytes: int
    unit: float
    counts: Callable[[Floats, bool], Integers]
    frame: Callable[[int, Integers], bytes]

    def planned(self, frame_bytes: int) -> int:
        """Return the intended number of samples in a frame of limited size."""
        return max(1, (frame_bytes - pmd.HEADER_BYTES) // self.sample_bytes)

    def split(
        self, counts: Integers, stamps_ns: list[int], frame_bytes: int
    ) -> Iterator[tuple[Integers, bytes]]:
        """Split samples into frames of limited size, by halving them if needed."""
        frame = self.frame(stamps_ns[-1], counts)
        if len(frame) <= frame_bytes or len(counts) == 1:
            yield counts, frame
            return
        half = len(counts) // 2
        yield from self.split(counts[:half], stamps_ns[:half], frame_bytes)
        yield from self.split(counts[half:], stamps_ns[half:], frame_bytes)


def waveform(
    product: Product,
    measurement: Measurement,
    settings: Mapping[Setting, int],
    wearer: Wearer,
    *,
    compressed: bool,
) -> Waveform:
    """Return the waveform of a product's measurement.

    Parameters
    ----------
    compressed
        Send acceleration compressed, even if the product does not; it must measure in mg.
    """
    rate = settings[Setting.SAMPLE_RATE]
    match measurement:
        case Measurement.ECG:
            return Waveform("ecg", rate, 3, 1.0, partial(_ecg, wearer), pmd.ecg)
        case Measurement.PPG:
            channels = 2 if product.ppg_format == pmd.PPG_OF_TWO_DIODES else 4
            size = 12 // _COMPRESSION
            frame = partial(pmd.ppg, frame_format=product.ppg_format)
            return Waveform("ppg", rate, size, 1.0, partial(_ppg, wearer, channels), frame)
        case Measurement.GYRO:
            unit = product.unit(measurement, settings)
            counts = partial(_rotation, wearer, unit)
            return Waveform("gyro", rate, 6 // _COMPRESSION, unit, counts, pmd.angular_velocity)
        case Measurement.MAGNETOMETER:
            unit = product.unit(measurement, settings)
            in_microtesla = unit * _MICROTESLA_PER_GAUSS
            counts = partial(_field, wearer, unit)
            size = 6 // _COMPRESSION
            return Waveform("mag", rate, size, in_microtesla, counts, pmd.magnetic_field)
        case Measurement.ACC:
            unit_g = product.unit(measurement, settings)
            limit = min(_INT16_LIMIT, round(settings[Setting.RANGE] / unit_g))
            raw = product.acc_format == pmd.ACC_16_BIT and not compressed
            layout = pmd.ACC_COMPRESSED_MG if compressed else product.acc_format
            size = 6 if raw else 6 // _COMPRESSION
            counts = partial(_acceleration, wearer, unit_g, limit)
            frame = partial(pmd.acceleration, frame_format=layout)
            return Waveform("acc", rate, size, unit_g, counts, frame)
        case _:
            raise ValueError(f"{measurement.name} has no waveform")


def _ecg(wearer: Wearer, t: Floats, worn: bool) -> Integers:
    microvolts = wearer.ecg_uv(t) if worn else wearer.noise(t, _OPEN_ELECTRODES_UV, "electrodes")
    return _round(microvolts[:, np.newaxis], _ECG_LIMIT_UV)


def _acceleration(wearer: Wearer, unit: float, limit: int, t: Floats, _worn: bool) -> Integers:
    return _round(wearer.acceleration_g(t) / unit, limit)


def _ppg(wearer: Wearer, channels: int, t: Floats, worn: bool) -> Integers:
    pulse = wearer.pulse(t)[:, np.newaxis] * _PPG_PULSE[:channels] * worn
    noise = wearer.noise(t, _PPG_NOISE, "photodiode")[:, np.newaxis]
    return _round(_PPG_LEVELS[:channels] + pulse + noise, 1 << 21)


def _rotation(wearer: Wearer, unit: float, t: Floats, _worn: bool) -> Integers:
    turns = [wearer.noise(t, _TURNS_DEG_S, f"turn {axis}") for axis in "xyz"]
    return _round(np.stack(turns, axis=1) / unit, _INT16_LIMIT)


def _field(wearer: Wearer, unit: float, t: Floats, _worn: bool) -> Integers:
    noise = [wearer.noise(t, _FIELD_NOISE_GAUSS, f"field {axis}") for axis in "xyz"]
    return _round((_FIELD_GAUSS + np.stack(noise, axis=1)) / unit, _INT16_LIMIT)


def _round(values: Floats, limit: int) -> Integers:
    return np.rint(np.clip(values, -limit, limit)).astype(np.int64)
