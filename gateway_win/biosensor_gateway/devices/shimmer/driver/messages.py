"""A Shimmer's messages, as records."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import NamedTuple


@dataclass(frozen=True, slots=True)
class Ack:
    """A command was carried out; which one, only the order tells."""


@dataclass(frozen=True, slots=True)
class Nack:
    """A command was refused."""


@dataclass(frozen=True, slots=True)
class Packet:
    """One sample of every channel.

    Attributes
    ----------
    ticks
        Low 24 bits of the device's counter of 1/32768 s.
    values
        Raw, in the order of the inquiry.
    """

    ticks: int
    values: tuple[int, ...]


class StatusFlag(IntFlag):
    """Bits of the status byte."""

    DOCKED = 1
    SENSING = 2
    CLOCK_SET = 4
    LOGGING = 8
    STREAMING = 16
    CARD_PRESENT = 32
    CARD_ERROR = 64
    RED_LED = 128


@dataclass(frozen=True, slots=True)
class Status:
    """State of the device, asked for or told by itself."""

    flags: StatusFlag


class Charging(IntEnum):
    """What the charger of a docked device says."""

    SUSPENDED = 0xC0
    CHARGING = 0x80
    FULL = 0x40
    BAD_BATTERY = 0x00
    UNKNOWN = 0xFF
    """Not docked."""


@dataclass(frozen=True, slots=True)
class BatteryReading:
    """Battery voltage as the ADC sees it, and the charger's byte; see :class:`Charging`."""

    adc: int
    charger: int


@dataclass(frozen=True, slots=True)
class Hardware:
    """3 for a Shimmer3, 10 for a Shimmer3R."""

    version: int


class FirmwareKind(IntEnum):
    """Families of firmware."""

    BT_STREAM = 1
    SD_LOG = 2
    LOG_AND_STREAM = 3


@dataclass(frozen=True, slots=True)
class Firmware:
    """Family (see :class:`FirmwareKind`) and version (major, minor, patch)."""

    kind: int
    version: tuple[int, int, int]

    def __str__(self) -> str:
        names = {1: "BtStream", 2: "SDLog", 3: "LogAndStream"}
        return f"{names.get(self.kind, f'firmware {self.kind}')} {'.'.join(map(str, self.version))}"


@dataclass(frozen=True, slots=True)
class DaughterCard:
    """First bytes of the expansion board's memory: board, revision, special revision."""

    data: bytes


@dataclass(frozen=True, slots=True)
class GsrRange:
    """Setting of the feedback resistor, 4 for automatic."""

    setting: int


@dataclass(frozen=True, slots=True)
class ExpansionPower:
    """Whether the optical probe has power."""

    on: bool


@dataclass(frozen=True, slots=True)
class ExgRegisters:
    """Registers of one of the two ExG chips, from `commands.get_exg_registers`."""

    data: bytes


@dataclass(frozen=True, slots=True)
class Calibration:
    """All calibration blocks of the motion sensors, 21 bytes each; see `calibration`."""

    data: bytes


class PressureChip(IntEnum):
    """Pressure sensors that a Shimmer may have."""

    BMP180 = 0
    BMP280 = 1
    BMP390 = 2
    BMP581 = 3


@dataclass(frozen=True, slots=True)
class PressureCoefficients:
    """Which pressure sensor it is (see `PressureChip`), and the coefficients in its memory."""

    chip: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Inquiry:
    """How the device is set up.

    Attributes
    ----------
    divisor
        The sampling rate is 32768 Hz divided by it.
    setup
        Configuration bytes, 4 of a Shimmer3 and 7 of a Shimmer3R.
    channels
        Ids of the channels in the order of a data packet.
    """

    divisor: int
    setup: bytes
    channels: tuple[int, ...]

    @property
    def expansion_power(self) -> bool:
        """Whether the optical probe has power."""
        return bool(self.setup[3] & 1)

    @property
    def pressure_oversampling(self) -> int:
        """Setting of the pressure sensor, 0 to 3; its highest bits on a Shimmer3R are elsewhere."""
        return self.setup[3] >> 4 & 3

    @property
    def gsr_range(self) -> int:
        """Setting of the feedback resistor, 4 for automatic."""
        return self.setup[3] >> 1 & 7


Reply = (
    Ack
    | Nack
    | Status
    | BatteryReading
    | Hardware
    | Firmware
    | DaughterCard
    | GsrRange
    | ExpansionPower
    | ExgRegisters
    | Calibration
    | PressureCoefficients
    | Inquiry
)
"""What may answer a command; a status also comes unasked."""
Message = Packet | Reply


class Stamped(NamedTuple):
    """A message and when its last byte arrived, in seconds of the LSL clock."""

    message: Message
    arrival_s: float
