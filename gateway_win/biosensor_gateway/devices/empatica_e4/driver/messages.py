"""The messages of the E4 streaming server, as records."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, unique


@unique
class Stream(Enum):
    """Streams by the word that subscribes them; heart rate comes with the intervals."""

    ACC = "acc"
    BVP = "bvp"
    GSR = "gsr"
    IBI = "ibi"
    TMP = "tmp"
    BAT = "bat"
    TAG = "tag"
    HR = "hr"


@unique
class Flaw(Enum):
    """Why a line was dropped."""

    BAD_FIELD_COUNT = "bad_field_count"
    BAD_NUMBER = "bad_number"
    NON_FINITE = "non_finite"
    UNKNOWN_STREAM = "unknown_stream"
    UNKNOWN_LINE = "unknown_line"
    UNKNOWN_REPLY = "unknown_reply"
    BAD_DEVICE_LIST = "bad_device_list"
    BAD_ENCODING = "bad_encoding"
    LINE_TOO_LONG = "line_too_long"
    EOF_PARTIAL_LINE = "eof_partial_line"


@unique
class RadioEvent(Enum):
    """What the server says unasked of a wristband's radio link."""

    LOST = "ble_lost"
    RESTORED = "ble_restored"
    TURNED_OFF = "turned_off"


@dataclass(frozen=True, slots=True)
class Sample:
    """One sample.

    Attributes
    ----------
    stream
    time_s
        Unix time: the server's clock at the first packet of the radio link, plus the
        sample's number over the nominal rate.
    values
        As on the wire: acc in 1/64 g, bat as a fraction, tag empty.
    """

    stream: Stream
    time_s: float
    values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Wristband:
    """One entry of a device list.

    Attributes
    ----------
    device
        Six hex digits, lower case.
    allowed
        False if the server's API key does not own it.
    """

    device: str
    allowed: bool = True


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer to a request.

    Attributes
    ----------
    command
    accepted
    subject
        The stream of a subscription, ON or OFF of a pause; else empty.
    reason
        The server's free text if it refused.
    devices
        Of a device list.
    """

    command: str
    accepted: bool
    subject: str = ""
    reason: str = ""
    devices: tuple[Wristband, ...] = ()


@dataclass(frozen=True, slots=True)
class Event:
    """A change of a wristband's radio link; ``device`` is in lower case."""

    event: RadioEvent
    device: str


@dataclass(frozen=True, slots=True)
class Malformed:
    """A line that was dropped, and why."""

    flaw: Flaw
    raw: str = ""


Message = Sample | Reply | Event | Malformed
