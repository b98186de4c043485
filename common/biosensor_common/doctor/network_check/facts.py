"""The facts that each of the two computers tells of itself and of what reached it.

They are read from the other one with care: what comes has the type of its field, and a size.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from ipaddress import IPv4Address
from types import UnionType
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

from biosensor_common.doctor.check import AGENT, NODE
from biosensor_common.doctor.firewall import BY_FIREWALL
from biosensor_common.doctor.network_check.channel import NONCE, Message
from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_common.lsl.api_file import Ports

SYSTEMS = ("win32", "linux", "darwin")
MAX_STREAMS = 256
MAX_TEXT = 256
MAX_TEST_PORTS = 8
# It goes into a question to liblsl, which has a syntax.
_SOURCE_ID = re.compile(rf"[a-z]+-{NONCE.pattern}")

Record = TypeVar("Record")


def _wrong(name: str, what: str) -> ProtocolError:
    return ProtocolError(
        ProtocolReason.GARBAGE,
        f"the other computer sent {name} that is not {what}; install the same Biosensor Gateway "
        "on both",
    )


def _program(name: str, found: str) -> str:
    if found not in {AGENT, NODE}:
        raise _wrong(name, f"one of {AGENT}, {NODE}")
    return found


def _address(name: str, found: str) -> str:
    try:
        return str(IPv4Address(found))
    except ValueError as error:
        raise _wrong(name, "an IPv4 address") from error


def _source_id(_name: str, found: str) -> str:
    if not _SOURCE_ID.fullmatch(found):
        raise ProtocolError(ProtocolReason.GARBAGE, "the test stream's name is none of ours")
    return found


def _few(_name: str, found: tuple[int, ...]) -> tuple[int, ...]:
    if len(found) > MAX_TEST_PORTS:
        raise _wrong("a list", f"of at most {MAX_TEST_PORTS} entries")
    return found


def _known_system(_name: str, found: str) -> str:
    return found if found in SYSTEMS else ""


def _known_firewalls(_name: str, found: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(each for each in found if each in BY_FIREWALL)


Address = Annotated[str, _address]
# No port has the number 0; what is only an int is a port that needs no administrator.
_ANY, _FREE = range(65536), range(1024, 65536)
PortOrNone = Annotated[int, _ANY]
TestPorts = Annotated[tuple[int, ...], _few]
ByPort = dict[int, bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class Computer:
    """One of the two computers, and how LSL is set up there.

    Attributes
    ----------
    system
        As ``sys.platform`` has it; empty for any but those of `SYSTEMS`.
    address
        Its own end of the conversation, by itself.
    other
        The other end, as it is seen from here.
    is_near
        Whether the other's address is in a network of one of its adapters.
    keeps_to_itself
        Whether its LSL looks for streams on this computer only.
    asks_the_other
        Whether its LSL asks the other one directly (KnownPeers).
    firewalls
        Which ones of Linux are on, as far as anybody can see.
    """

    name: str
    system: Annotated[str, _known_system]
    program: Annotated[str, _program]
    address: Address
    other: Address
    is_near: bool
    session: str
    ports: Ports
    keeps_to_itself: bool = False
    asks_the_other: bool = False
    firewalls: Annotated[tuple[str, ...], _known_firewalls] = ()


@dataclass(frozen=True, slots=True)
class Stream:
    """A real stream as a computer sees it, and the TCP port of its data."""

    name: str
    source_id: str
    uid: str
    host: str
    port: PortOrNone


@dataclass(frozen=True, slots=True)
class Targets:
    """Where one computer can be reached during a test; *discovery* is 0 if it cannot be had."""

    discovery: PortOrNone
    udp: TestPorts
    tcp: TestPorts


@dataclass(frozen=True, slots=True)
class Opened:
    """What one computer has opened for the other: ports, and a test stream."""

    targets: Targets
    source_id: Annotated[str, _source_id]


@dataclass(slots=True)
class Arrivals:
    """What came in at test ports from the other computer.

    Attributes
    ----------
    multicast
        From which of the other's addresses; None where it was not tried.
    discovery
        Whether anything came at LSL's discovery port; None if that could not be had.
    udp, tcp
        By port, lowest first.
    """

    multicast: tuple[str, ...] | None = None
    discovery: bool | None = None
    udp: ByPort = field(default_factory=ByPort)
    tcp: ByPort = field(default_factory=ByPort)


@dataclass(frozen=True, slots=True)
class Look:
    """What liblsl made of the other's test stream.

    Attributes
    ----------
    by_multicast
        Whether it was found so; None where that was not tried.
    directly
        Whether it was found by asking the other's address (KnownPeers).
    address
        From where its data came, by IPv4 or IPv6; empty if none did.
    received
        Whether a sample came.
    offset_s, round_trip_s
        Of its clock; None if that could not be measured.
    """

    by_multicast: bool | None = None
    directly: bool = False
    address: str = ""
    received: bool = False
    offset_s: float | None = None
    round_trip_s: float | None = None


@dataclass(frozen=True, slots=True)
class End:
    """One computer with all that it has found out.

    Attributes
    ----------
    own
        Streams that are sent from here.
    seen
        Streams of all others.
    reached
        Of the other's streams, those whose data port could be opened from here, by uid.
    """

    computer: Computer
    arrivals: Arrivals
    look: Look
    own: tuple[Stream, ...] = ()
    seen: tuple[Stream, ...] = ()
    reached: tuple[str, ...] = ()


def as_message(end: End) -> Message:
    """Return what `read` understands, which is also what scripts are told."""
    message = asdict(end)
    message["computer"]["ports"] = end.computer.ports._asdict()
    return message


def read(kind: type[Record], found: object) -> Record:
    """Return what the other computer sent as a record, or a tuple of them.

    Raises
    ------
    ProtocolError
        ``GARBAGE``: something in it has not the type or the size of its field.
    """
    return cast("Record", _read("a message", kind, found))


def read_run(message: Message) -> str:
    """Return the number of the test; raises as `read` does."""
    found = str(message.get("run"))
    if not NONCE.fullmatch(found):
        raise ProtocolError(ProtocolReason.GARBAGE, "the number of the test is none of ours")
    return found


def _read(name: str, kind: Any, found: object) -> object:  # noqa: ANN401 - also unions
    origin, of = get_origin(kind), get_args(kind)
    if origin is Annotated:
        plain, check = of
        is_range = isinstance(check, range)
        return _number(name, found, check) if is_range else check(name, _read(name, plain, found))
    if origin is UnionType:
        # With None, in each of them.
        return None if found is None else _read(name, of[0], found)
    if origin is tuple:
        return tuple(_read(name, of[0], each) for each in _entries(found))
    if kind in _PLAIN:
        return _PLAIN[kind](name, found)
    fields = _object(found)
    hints = get_type_hints(kind, include_extras=True)
    return kind(**{each: _read(each, hint, fields.get(each)) for each, hint in hints.items()})


def _text(name: str, found: object) -> str:
    if not isinstance(found, str) or len(found) > MAX_TEXT:
        raise _wrong(name, f"a text of at most {MAX_TEXT} characters")
    return found


def _flag(name: str, found: object) -> bool:
    if not isinstance(found, bool):
        raise _wrong(name, "true or false")
    return found


def _real(name: str, found: object) -> float:
    # Python takes true and false for numbers.
    if isinstance(found, bool) or not isinstance(found, int | float):
        raise _wrong(name, "a number")
    if not math.isfinite(found):
        raise _wrong(name, "a finite number")
    return float(found)


def _number(name: str, found: object, within: range = _FREE) -> int:
    if isinstance(found, bool) or not isinstance(found, int) or found not in within:
        raise _wrong(name, f"a number from {within.start} to {within.stop - 1}")
    return found


def _object(found: object) -> dict[str, object]:
    if not isinstance(found, dict):
        raise _wrong("a message", "an object")
    return cast("dict[str, object]", found)


def _entries(found: object) -> list[object]:
    if not isinstance(found, list):
        raise _wrong("an entry", "a list")
    several = cast("list[object]", found)
    if len(several) > MAX_STREAMS:
        raise _wrong("a list", f"of at most {MAX_STREAMS} entries")
    return several


def _by_port(name: str, found: object) -> ByPort:
    """Read true or false for a few ports, which JSON has as text."""
    fields = _object(found)
    if len(fields) > MAX_TEST_PORTS:
        raise _wrong("a list", f"of at most {MAX_TEST_PORTS} entries")
    if not all(map(str.isdecimal, fields)):
        raise _wrong(name, "ports")
    return {int(port): _flag(port, came) for port, came in fields.items()}


_PLAIN: dict[object, Callable[[str, object], object]] = {
    str: _text,
    bool: _flag,
    int: _number,
    float: _real,
    ByPort: _by_port,
}
