"""The text protocol of the E4 streaming server: requests and parsing, without I/O.

The grammar is from the vendor's documentation of 2019, and from data captured on a Windows system
with a decimal comma. The decimal mark depends on the server's locale and may change when it
restarts, so both are always accepted.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, unique

MAX_LINE_BYTES = 65536
MAX_TIME_S = 1e11
"""Upper limit of valid clock times."""


@unique
class Stream(Enum):
    """Streams by the word for their subscription; heart rate is sent with the intervals."""

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
    """Events of a wristband's radio link that the server reports."""

    LOST = "ble_lost"
    RESTORED = "ble_restored"
    TURNED_OFF = "turned_off"


@dataclass(frozen=True, slots=True)
class Sample:
    """One sample."""

    stream: Stream
    # Unix time: the server's time of the radio link's first packet, plus the sample's number
    # divided by the nominal rate.
    time_s: float
    values: tuple[float, ...]  # Values as sent: acc in 1/64 g, bat as a fraction, tag empty.


@dataclass(frozen=True, slots=True)
class Wristband:
    """One entry of a device list."""

    device: str  # Six hex digits, lower case.
    allowed: bool = True  # False if the server's API key does not own it.


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer to a request."""

    command: str
    accepted: bool
    subject: str = ""  # The stream of a subscription, ON or OFF of a pause; else empty.
    reason: str = ""  # The server's free text if it refused.
    devices: tuple[Wristband, ...] = ()  # Entries of a device list.


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

SUBSCRIBED = (Stream.ACC, Stream.BVP, Stream.GSR, Stream.IBI, Stream.TMP, Stream.BAT, Stream.TAG)

_WORDS = {
    "E4_Acc": Stream.ACC,
    "E4_Bvp": Stream.BVP,
    "E4_Gsr": Stream.GSR,
    "E4_Ibi": Stream.IBI,
    "E4_Hr": Stream.HR,
    # The names in the vendor's table differ from those actually sent.
    "E4_Temperature": Stream.TMP,
    "E4_Temp": Stream.TMP,
    "E4_Battery": Stream.BAT,
    "E4_Bat": Stream.BAT,
    "E4_Tag": Stream.TAG,
}
_VALUES = {Stream.ACC: 3, Stream.TAG: 0}
_LISTS = ("device_list", "device_discover_list")
_COMMANDS = frozenset(
    {
        *_LISTS,
        "device_connect",
        "device_connect_btle",
        "device_disconnect",
        "device_disconnect_btle",
        "device_subscribe",
        "pause",
        "server_status",
    }
)
_EVENTS = (
    (re.compile(r"R connection lost to device (\w+)"), RadioEvent.LOST),
    (re.compile(r"R connection re-established to device (\w+)"), RadioEvent.RESTORED),
    (re.compile(r"R device (\w+) turned off via button"), RadioEvent.TURNED_OFF),
)
_NUMBER = re.compile(r"-?[0-9]+(?:\.[0-9]+)?(?:[eE][+-]?[0-9]+)?")
_NON_FINITE = re.compile(r"-?(?:nan|inf(?:inity)?|∞)", re.IGNORECASE)
_UNICODE_MINUS = "\N{MINUS SIGN}"


def request(command: str, *arguments: str) -> bytes:
    """Return a request; every server accepts CRLF."""
    return " ".join((command, *arguments)).encode("ascii") + b"\r\n"


class E4Protocol:
    """Splits the byte stream into lines and parses them."""

    def __init__(self) -> None:
        self.dropped_bytes = 0  # Bytes of invalid lines, without line ends.
        self._buffer = bytearray()
        self._skipping = False

    @property
    def buffered(self) -> int:
        """Number of bytes of the incomplete line."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Message]:
        """Add bytes and return the messages of the completed lines, in order."""
        messages: list[Message] = []
        *ends, rest = data.split(b"\n")
        for end in ends:
            messages += self._line(end)
        messages += self._keep(rest)
        return messages

    def finish(self) -> list[Message]:
        """Discard the incomplete line at the end of a connection, which is never a sample."""
        rest = bytes(self._buffer)
        self._buffer.clear()
        self._skipping = False
        if not rest:
            return []
        self.dropped_bytes += len(rest)
        return [Malformed(Flaw.EOF_PARTIAL_LINE, rest.decode("utf-8", "replace"))]

    def _line(self, end: bytes) -> list[Message]:
        if self._skipping:
            self.dropped_bytes += len(end)
            self._skipping = False
            return []
        overflow = self._keep(end)
        if overflow:
            self._skipping = False
            return overflow
        raw = bytes(self._buffer).removesuffix(b"\r")
        self._buffer.clear()
        return self._read(raw) if raw.strip() else []

    def _keep(self, part: bytes) -> list[Message]:
        if self._skipping:
            self.dropped_bytes += len(part)
            return []
        self._buffer += part
        if len(self._buffer) <= MAX_LINE_BYTES:
            return []
        self.dropped_bytes += len(self._buffer)
        self._buffer.clear()
        self._skipping = True
        return [Malformed(Flaw.LINE_TOO_LONG)]

    def _read(self, raw: bytes) -> list[Message]:
        try:
            message = read_line(raw.decode("utf-8"))
        except UnicodeDecodeError:
            message = Malformed(Flaw.BAD_ENCODING)
        if isinstance(message, Malformed):
            self.dropped_bytes += len(raw)
        return [message]


def read_line(line: str) -> Message:
    """Parse a line without its line end; never raises."""
    text = line.strip()
    for pattern, event in _EVENTS:
        # Checked before replies, because "connection" and "device" are not commands.
        if found := pattern.fullmatch(text):
            return Event(event, found[1].lower())
    words = text.split()
    if not words:
        return Malformed(Flaw.UNKNOWN_LINE, text)
    if words[0] == "R":
        return _reply(words[1:], text)
    if words[0].startswith("E4_"):
        return _sample(words, text)
    if words[0] == "device_disconnect":
        # One version of the server is reported to omit the R.
        return _reply(words, text)
    return Malformed(Flaw.UNKNOWN_LINE, text)


def _sample(words: list[str], text: str) -> Message:
    stream = _WORDS.get(words[0])
    if stream is None:
        return Malformed(Flaw.UNKNOWN_STREAM, text)
    if len(words) != 2 + _VALUES.get(stream, 1):
        return Malformed(Flaw.BAD_FIELD_COUNT, text)
    numbers: list[float] = []
    for word in words[1:]:
        number = _number(word)
        if isinstance(number, Flaw):
            return Malformed(number, text)
        numbers.append(number)
    if not 0 < numbers[0] < MAX_TIME_S:
        return Malformed(Flaw.BAD_NUMBER, text)
    return Sample(stream, numbers[0], tuple(numbers[1:]))


def _number(word: str) -> float | Flaw:
    plain = word.replace(",", ".").replace(_UNICODE_MINUS, "-")
    if _NON_FINITE.fullmatch(plain):
        return Flaw.NON_FINITE
    if not _NUMBER.fullmatch(plain):
        return Flaw.BAD_NUMBER
    number = float(plain)
    return number if math.isfinite(number) else Flaw.NON_FINITE


def _reply(words: list[str], text: str) -> Message:
    if not words or words[0] not in _COMMANDS:
        return Malformed(Flaw.UNKNOWN_REPLY, text)
    command, *rest = words
    reader: Callable[[str, list[str], str], Message] = _plain_reply
    if command in _LISTS:
        reader = _device_list
    elif command in ("device_subscribe", "pause"):
        reader = _reply_with_subject
    return reader(command, rest, text)


def _plain_reply(command: str, rest: list[str], text: str) -> Message:
    del text
    if rest and rest[0] in ("ERR", "ERROR"):
        return Reply(command, accepted=False, reason=" ".join(rest[1:]))
    return Reply(command, accepted=True)


def _reply_with_subject(command: str, rest: list[str], text: str) -> Message:
    """Parse a reply whose first word is a stream, or the ON or OFF of a pause."""
    if not rest:
        return Malformed(Flaw.UNKNOWN_REPLY, text)
    if rest[0] in ("ERR", "ERROR"):
        return _plain_reply(command, rest, text)
    subject, *status = rest
    plain = _plain_reply(command, status, text)
    assert isinstance(plain, Reply)
    return Reply(command, plain.accepted, subject, plain.reason)


def _device_list(command: str, rest: list[str], text: str) -> Message:
    if rest and rest[0] in ("ERR", "ERROR"):
        return _plain_reply(command, rest, text)
    count, *entries = (part.split() for part in " ".join(rest).split("|"))
    is_count = len(count) == 1 and count[0].isascii() and count[0].isdigit()
    if not is_count or len(entries) != int(count[0][:6]) or not all(entries):
        return Malformed(Flaw.BAD_DEVICE_LIST, text)
    devices = tuple(
        Wristband(entry[0].lower(), allowed="not_allowed" not in entry[1:]) for entry in entries
    )
    return Reply(command, accepted=True, devices=devices)
