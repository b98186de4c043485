"""Products of the Polar family, with firmware variants and quirks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, unique

from biosensor_gateway.devices.polar_h10.simulator.pmd import (
    ACC_16_BIT,
    FULL_MTU,
    PPG_OF_THREE_LEDS,
    Measurement,
    Offered,
    Setting,
    encode_factor,
)

_CHEST = 1


@dataclass(frozen=True)
class Product:
    """The properties of a product.

    Attributes
    ----------
    advertised
        Its advertised name, before the device id.
    model, firmware
        As in the Device Information service.
    body_location
        Value of 0x2A38.
    sends_rr
        Whether heart rate measurements contain R-R intervals.
    settings
        Measurements with their available settings, in the order of the reply.
    start_parameters
        Parameters of the reply to a start, if these are not a unit.
    acc_format
        Format byte of acceleration frames.
    units
        Size of one count [g, deg/s or gauss], for measurements with a single range.
    units_per_range
        Size of one count per unit of the chosen range, which the reply to a start contains.
    ppg_format
        Format byte of photoplethysmograms.
    minimum_mtu
        Starts over a link with a smaller ATT MTU fail.
    sdk_settings
        Measurements in SDK mode; empty if it does not have this mode.
    true_rates
        Real sample rates, by measurement and reported rate.
    tells_contact
        Whether heart rate measurements contain the skin contact.
    """

    advertised: str
    model: str
    firmware: str
    body_location: int
    sends_rr: bool
    settings: Mapping[Measurement, Offered]
    start_parameters: Mapping[Measurement, bytes]
    acc_format: int
    units: Mapping[Measurement, float] = field(default_factory=dict[Measurement, float])
    units_per_range: Mapping[Measurement, float] = field(default_factory=dict[Measurement, float])
    ppg_format: int = PPG_OF_THREE_LEDS
    minimum_mtu: int = 0
    sdk_settings: Mapping[Measurement, Offered] = field(default_factory=dict[Measurement, Offered])
    true_rates: Mapping[Measurement, Mapping[int, int]] = field(
        default_factory=dict[Measurement, Mapping[int, int]]
    )
    tells_contact: bool = False

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
    """Properties of a sensor that depend on firmware or circumstances.

    Attributes
    ----------
    demands_pairing
        The control point answers ATT error 0x05 until the host has paired.
    left_streaming
        Measurements that a previous host left running; they run from the first power-on.
    keeps_streaming
        Whether measurements continue when the link is lost.
    announces_stops
        A stop on command is followed by the packet that tells of a stop by the device.
    short_errors
        Whether error replies end after the status.
    max_mtu
        Largest ATT MTU that it accepts.
    minimum_mtu
        Starts over a link with a smaller ATT MTU are refused with INVALID_MTU.
    compressed_acceleration
        Whether acceleration is sent compressed, in mg.
    sampling_deviation
        Relative deviation of the true sample rates, in device time, from the nominal ones; the
        data sheet allows 0.02.
    first_sample_s
        Time from a start to its first sample.
    first_intervals_s
        Time from a start to the first pulse intervals; 25 s according to the vendor's documents.
    """

    firmware: Firmware = Firmware.CURRENT
    demands_pairing: bool = False
    left_streaming: tuple[Measurement, ...] = ()
    keeps_streaming: bool = False
    announces_stops: bool = False
    short_errors: bool = False
    max_mtu: int = FULL_MTU
    minimum_mtu: int = 0
    compressed_acceleration: bool = False
    sampling_deviation: float = 0.0
    first_sample_s: float = 0.0
    first_intervals_s: float = 25.0
