"""Products of the Polar family, with the firmware and circumstances of a virtual one."""

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
    """What distinguishes one product from another.

    Attributes
    ----------
    advertised
        Its name on the air, before the device id.
    model, firmware
        As the Device Information service has them.
    body_location
        Value of 0x2A38.
    sends_rr
        Whether heart rate measurements carry R-R intervals.
    settings
        What can be measured, with the settings on offer in the order of the reply.
    start_parameters
        What the reply to a start carries behind its status, where that is no unit.
    acc_format
        Format byte of acceleration frames.
    units
        What one count is [g, deg/s or gauss], of measurements with a single range.
    units_per_range
        The same for each unit of the range that was chosen, which the reply to a start names.
    ppg_format
        Format byte of photoplethysmograms.
    minimum_mtu
        Nothing is started over a link with a smaller ATT MTU.
    sdk_settings
        What can be measured in the SDK mode; empty = it has no such mode.
    true_rates
        By measurement and the rate that it says, the one at which it really sends.
    tells_contact
        Whether heart rate measurements tell of skin contact.
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
        """What the feature bits say."""
        sdk_mode = {Measurement.SDK_MODE} if self.sdk_settings else set[Measurement]()
        return frozenset(self.settings) | sdk_mode

    def offered(self, *, sdk_mode: bool) -> Mapping[Measurement, Offered]:
        """Return what can be measured in a mode, with the settings on offer."""
        return self.sdk_settings if sdk_mode else self.settings

    def unit(self, measurement: Measurement, chosen: Mapping[Setting, int]) -> float:
        """Return what one count is."""
        per_range = self.units_per_range.get(measurement)
        if per_range is None:
            return self.units.get(measurement, 1.0)
        return per_range * chosen[Setting.RANGE]

    def start_reply(self, measurement: Measurement, chosen: Mapping[Setting, int]) -> bytes:
        """Return what the reply to a start carries behind its status."""
        if measurement in self.units_per_range:
            return encode_factor(self.unit(measurement, chosen))
        return self.start_parameters.get(measurement, b"")

    def true_rate_hz(self, measurement: Measurement, said: int, *, sdk_mode: bool) -> int:
        """Return the rate at which it sends when it was asked for one that it says."""
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
    # One reserved byte, which is no setting, as a real H10 sends it.
    start_parameters={Measurement.ACC: b"\1"},
    acc_format=ACC_16_BIT,
    units={Measurement.ACC: 1e-3},
)


@unique
class Firmware(Enum):
    """Which services the firmware has for measurement data."""

    CURRENT = "current"
    """The PMD service."""
    OLD = "old"
    """The file transfer service alone, as an H10 before its update."""
    HEART_RATE_ONLY = "heart_rate_only"
    """Neither, as an H9."""


@dataclass(frozen=True)
class Quirks:
    """Properties that firmware or circumstances give to a sensor.

    Attributes
    ----------
    demands_pairing
        The control point answers ATT error 0x05 until the host has paired.
    left_streaming
        Measurements that a former host left on; they run from the first power-on.
    keeps_streaming
        Measurements go on when the link is lost.
    announces_stops
        A stop on command is followed by the packet that tells of a stop by the device.
    short_errors
        Replies of failure end after their status.
    max_mtu
        The largest ATT MTU that it grants.
    minimum_mtu
        A start over a link with a smaller ATT MTU is answered with INVALID_MTU.
    compressed_acceleration
        Acceleration is sent compressed, in mg.
    sampling_deviation
        By which fraction the true sampling rates, in the device's time, are higher than
        nominal; the data sheet allows 0.02.
    first_sample_s
        From a start to its first sample.
    first_intervals_s
        From a start to the first intervals between pulse waves; 25 s by the vendor's documents.
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
