"""Products of the Polar family: firmware variants, quirks, and waveforms of measurements."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum, unique
from functools import partial

import numpy as np

from biosensor_gateway.devices.polar_h10.simulator import pmd
from biosensor_gateway.devices.polar_h10.simulator.pmd import (
    ACC_16_BIT,
    FULL_MTU,
    PPG_OF_THREE_LEDS,
    Integers,
    Measurement,
    Offered,
    Setting,
    encode_factor,
)
from biosensor_gateway.simulation.wearer import Floats, Wearer

_CHEST = 1
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
class Product:
    """The properties of a product."""

    advertised: str  # Its advertised name, before the device id.
    # model, firmware: as in the Device Information service.
    model: str
    firmware: str
    body_location: int  # Value of 0x2A38.
    sends_rr: bool  # Whether heart rate measurements contain R-R intervals.
    # Measurements with their available settings, in the order of the reply.
    settings: Mapping[Measurement, Offered]
    # Parameters of the reply to a start, if these are not a unit.
    start_parameters: Mapping[Measurement, bytes]
    acc_format: int  # Format byte of acceleration frames.
    # Size of one count [g, deg/s or gauss], for measurements with a single range.
    units: Mapping[Measurement, float] = field(default_factory=dict[Measurement, float])
    # Size of one count per unit of the chosen range, which the reply to a start contains.
    units_per_range: Mapping[Measurement, float] = field(default_factory=dict[Measurement, float])
    ppg_format: int = PPG_OF_THREE_LEDS  # Format byte of photoplethysmograms.
    minimum_mtu: int = 0  # Starts over a link with a smaller ATT MTU fail.
    # Measurements in SDK mode; empty if it does not have this mode.
    sdk_settings: Mapping[Measurement, Offered] = field(default_factory=dict[Measurement, Offered])
    # Real sample rates, by measurement and reported rate.
    true_rates: Mapping[Measurement, Mapping[int, int]] = field(
        default_factory=dict[Measurement, Mapping[int, int]]
    )
    tells_contact: bool = False  # Whether heart rate measurements contain the skin contact.

    @property
    def features(self) -> frozenset[Measurement]:
        """The measurements in the feature bits."""
        sdk_mode = {Measurement.SDK_MODE} if self.sdk_settings else set[Measurement]()
        return frozenset(self.settings) | sdk_mode

    def offered(self, *, sdk_mode: bool) -> Mapping[Measurement, Offered]:
        """Return the measurements in a mode with their available settings."""
        return self.sdk_settings if sdk_mode else self.settings

    def unit(self, measurement: Measurement, chosen: Mapping[Setting, int]) -> float:
        """Return the size of one count."""
        per_range = self.units_per_range.get(measurement)
        if per_range is None:
            return self.units.get(measurement, 1.0)
        return per_range * chosen[Setting.RANGE]

    def start_reply(self, measurement: Measurement, chosen: Mapping[Setting, int]) -> bytes:
        """Return the parameters of the reply to a start."""
        if measurement in self.units_per_range:
            return encode_factor(self.unit(measurement, chosen))
        return self.start_parameters.get(measurement, b"")

    def true_rate_hz(self, measurement: Measurement, said: int, *, sdk_mode: bool) -> int:
        """Return the real sample rate for a reported one."""
        if sdk_mode:
            return said
        return self.true_rates.get(measurement, {}).get(said, said)


H10 = Product(
    advertised="Polar H10",
    model="H10",
    firmware="3.3.1",
    body_location=_CHEST,
    sends_rr=True,
    settings={
        Measurement.ECG: {Setting.SAMPLE_RATE: (130,), Setting.RESOLUTION: (14,)},
        Measurement.ACC: {
            Setting.SAMPLE_RATE: (25, 50, 100, 200),
            Setting.RESOLUTION: (16,),
            Setting.RANGE: (2, 4, 8),
        },
    },
    # One reserved byte that is not a setting, as sent by a real H10.
    start_parameters={Measurement.ACC: b"\1"},
    acc_format=ACC_16_BIT,
    units={Measurement.ACC: 1e-3},
)


@unique
class Firmware(Enum):
    """The services of the firmware for measurement data."""

    CURRENT = "current"
    """The PMD service."""
    OLD = "old"
    """Only the file transfer service, as in an H10 before its update."""
    HEART_RATE_ONLY = "heart_rate_only"
    """Neither, as in an H9."""


@dataclass(frozen=True)
class Quirks:
    """Properties of a sensor that depend on firmware or circumstances."""

    firmware: Firmware = Firmware.CURRENT
    # The control point answers ATT error 0x05 until the host has paired.
    demands_pairing: bool = False
    # Measurements that a previous host left running; they run from the first power-on.
    left_streaming: tuple[Measurement, ...] = ()
    keeps_streaming: bool = False  # Whether measurements continue when the link is lost.
    # A stop on command is followed by the packet that tells of a stop by the device.
    announces_stops: bool = False
    short_errors: bool = False  # Whether error replies end after the status.
    max_mtu: int = FULL_MTU  # Largest ATT MTU that it accepts.
    minimum_mtu: int = 0  # Starts over a link with a smaller ATT MTU are refused with INVALID_MTU.
    compressed_acceleration: bool = False  # Whether acceleration is sent compressed, in mg.
    # Time from a start to the first pulse intervals; 25 s according to the vendor's documents.
    first_intervals_s: float = 25.0


@dataclass(frozen=True)
class Waveform:
    """One measurement with its settings."""

    data_name: str  # Data name in the truth.
    rate_hz: int
    sample_bytes: int  # Usual size of a sample in a frame.
    unit: float  # Size of one count in the declared unit.
    # Returns counts, shape (n, channels), from the wearer's times [s] and whether the device is
    # worn.
    counts: Callable[[Floats, bool], Integers]
    # Returns a frame from the time of the last sample [ns] and the counts.
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
