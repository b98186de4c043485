"""A BioHarness' messages, as records."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass

from biosensor_gateway.devices.zephyr.driver.fields import Number
from biosensor_gateway.devices.zephyr.driver.frames import MessageId

# A centre of 512 gives 1.07 g at rest in recordings; the datasheet's other one, 533, 2.4 g.
ACCELERATION_ZERO = 512
ACCELERATION_COUNTS_PER_G = 20.75

_EPOCH = dt.datetime(2000, 1, 1)  # noqa: DTZ001 - the device's clock is naive local time


@dataclass(frozen=True, slots=True)
class Header:
    """What every periodic packet starts with.

    Attributes
    ----------
    sequence
        Counts packets of one kind, 0-255.
    time
        Device clock, naive local time of the first sample; None if not set.
    """

    sequence: int
    time: dt.datetime | None

    @property
    def device_s(self) -> float | None:
        """Device clock in seconds since 2000-01-01, None if it is not set."""
        return None if self.time is None else (self.time - _EPOCH).total_seconds()


@dataclass(frozen=True, slots=True)
class Waveform:
    """ECG (63 samples, 4 ms apart) or breathing (18 samples, 56 ms), in counts 0-1023."""

    message_id: MessageId
    header: Header
    samples: tuple[int, ...]
    period_s: float


@dataclass(frozen=True, slots=True)
class Acceleration:
    """20 samples of (X, Y, Z) in counts, 20 ms apart.

    ``counts_per_g`` and ``zero`` turn them into g: ``(counts - zero) / counts_per_g``.
    """

    header: Header
    samples: tuple[tuple[int, int, int], ...]
    counts_per_g: float = ACCELERATION_COUNTS_PER_G
    zero: int = ACCELERATION_ZERO


@dataclass(frozen=True, slots=True)
class RrIntervals:
    """18 readings of the last R-R interval in ms, 56 ms apart; the sign flips at each beat."""

    header: Header
    samples: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Status:
    """Status word of the summary packet; "unreliable" flags do not make a value invalid."""

    word: int

    def _bit(self, number: int) -> bool:
        return bool(self.word >> number & 1)

    @property
    def worn_level(self) -> int:
        """0 full, 1 high, 2 low confidence that it is worn; 3 not worn."""
        return self.word & 3

    @property
    def worn(self) -> bool:
        """Whether the device believes that it is worn."""
        return self.worn_level != 3

    @property
    def flags(self) -> dict[str, bool]:
        """All single-bit flags by name."""
        return {name: self._bit(number) for number, name in enumerate(_STATUS_BITS, start=2)}


_STATUS_BITS = (
    "button",
    "not_fitted",
    "hr_unreliable",
    "rr_unreliable",
    "skin_temp_unreliable",
    "posture_unreliable",
    "activity_unreliable",
    "hrv_unreliable",
    "core_temp_unreliable",
)


@dataclass(frozen=True, slots=True)
class Summary:
    """Vital signs, once a second.

    Attributes
    ----------
    numbers
        Decoded numbers by name, unit in the name, None where invalid.
    rog_status, rog_time_s
        "Red orange green" state of the wearer and the seconds spent in it.
    extra
        GPS and movement bit fields of version 3, empty in version 2.
    """

    header: Header
    version: int
    numbers: dict[str, Number]
    status: Status
    rog_status: str
    rog_time_s: int
    extra: dict[str, dict[str, int | float]]


@dataclass(frozen=True, slots=True)
class General:
    """Vital signs of devices that know no summary packet (BioHarness 2)."""

    header: Header
    numbers: dict[str, Number]
    battery_percent: int
    worn: bool
    button: bool
    hr_signal_low: bool
    external_sensors: bool


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened on the device, stamped when it happened."""

    header: Header
    code: int
    name: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Reply:
    """Answer to a request of the same id."""

    request_id: int
    accepted: bool
    data: bytes


@dataclass(frozen=True, slots=True)
class Lifesign:
    """The device is alive; nothing else."""


@dataclass(frozen=True, slots=True)
class Unknown:
    """A well-formed frame that nothing is known about."""

    message_id: int


Message = (
    Waveform | Acceleration | RrIntervals | Summary | General | Event | Reply | Lifesign | Unknown
)
