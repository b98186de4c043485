"""The facts that each of the two computers tells of itself and of what reached it.

They are read from the other one with care: what comes has the type of its field, and a size.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
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
_LOWEST_PORT, _HIGHEST_PORT = 1024, 65535

_KINDS: dict[type, str] = {str: "a text", bool: "true or false", int: "a number", float: "a number"}
Record = TypeVar("Record")


def _wrong(name: str, what: str) -> ProtocolError:
    return ProtocolError(
        ProtocolReason.GARBAGE,
        f"the other computer sent {name} that is not {what}; install the same Biosensor Gateway "
        "on both",
    )


def _only_if(right: Callable[[Any], object], what: str) -> Callable[[str, Any], Any]:
    """Return what lets a value pass if it is right."""

    def check(name: str, found: object) -> object:
        if not right(found):
            raise _wrong(name, what)
        return found

    return check


def _is_address(text: str) -> bool:
    try:
        IPv4Address(text)
    except ValueError:
        return False
    return True


def _are_ports(found: Iterable[int]) -> bool:
    return all(_LOWEST_PORT <= port <= _HIGHEST_PORT for port in found)


def _few_ports(found: tuple[int, ...]) -> bool:
    return len(found) <= MAX_TEST_PORTS and _are_ports(found)


def _known_system(_name: str, found: str) -> str:
    return found if found in SYSTEMS else ""


def _known_firewalls(_name: str, found: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(each for each in found if each in BY_FIREWALL)


Address = Annotated[str, _only_if(_is_address, "an IPv4 address")]
# No port has the number 0.
PortOrNone = Annotated[int, _only_if(lambda port: 0 <= port <= _HIGHEST_PORT, "a port")]
TestPorts = Annotated[tuple[int, ...], _only_if(_few_ports, f"at most {MAX_TEST_PORTS} ports")]
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
    program: Annotated[str, _only_if((AGENT, NODE).__contains__, f"one of {AGENT}, {NODE}")]
    address: Address
    other: Address
    is_near: bool
    session: str
    ports: Annotated[Ports, _only_if(_are_ports, "ports that need no administrator")]
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
    source_id: Annotated[str, _only_if(_SOURCE_ID.fullmatch, "the name of a test stream")]


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
    check = _only_if(NONCE.fullmatch, "the number of a test")
    return cast("str", check("run", _read("run", str, message.get("run"))))


def _read(name: str, kind: Any, found: object) -> object:  # noqa: ANN401 - also unions
    origin, of = get_origin(kind), get_args(kind)
    if origin is Annotated:
        plain, check = of
        return check(name, _read(name, plain, found))
    if origin is UnionType:
        # With None, in each of them.
        return None if found is None else _read(name, of[0], found)
    if origin is tuple:
        return tuple(_read(name, of[0], each) for each in _entries(name, found))
    if origin is dict:
        return _by_port(name, found)
    if kind in _KINDS:
        return _plain(name, kind, found)
    fields = _object(name, found)
    hints = get_type_hints(kind, include_extras=True)
    return kind(**{each: _read(each, hint, fields.get(each)) for each, hint in hints.items()})


def _plain(name: str, kind: type, found: object) -> object:
    is_right = isinstance(found, int | float) if kind is float else isinstance(found, kind)
    # Python takes true and false for numbers.
    if not is_right or (kind is not bool and isinstance(found, bool)):
        raise _wrong(name, _KINDS[kind])
    if isinstance(found, str) and len(found) > MAX_TEXT:
        raise _wrong(name, f"a text of at most {MAX_TEXT} characters")
    if isinstance(found, float) and not math.isfinite(found):
        raise _wrong(name, "a finite number")
    return float(cast("float", found)) if kind is float else found


def _object(name: str, found: object) -> dict[str, object]:
    if not isinstance(found, dict):
        raise _wrong(name, "an object")
    return cast("dict[str, object]", found)


def _entries(name: str, found: object) -> list[object]:
    if not isinstance(found, list) or len(cast("list[object]", found)) > MAX_STREAMS:
        raise _wrong(name, f"a list of at most {MAX_STREAMS} entries")
    return cast("list[object]", found)


def _by_port(name: str, found: object) -> ByPort:
    """Read true or false for a few ports, which JSON has as text."""
    fields = _object(name, found)
    if len(fields) > MAX_TEST_PORTS or not all(map(str.isdecimal, fields)):
        raise _wrong(name, f"at most {MAX_TEST_PORTS} ports")
    return {int(port): cast("bool", _plain(port, bool, came)) for port, came in fields.items()}
