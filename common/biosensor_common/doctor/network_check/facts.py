"""Facts that each computer reports about itself and about what it received.

The other computer's facts are not trusted: the type and size of each field are checked.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sized
from dataclasses import asdict, dataclass, field
from functools import partial
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
MAX_NUMBER = 1e300
MAX_TEST_PORTS = 8
# The name becomes part of a liblsl query, so its characters are limited.
_SOURCE_ID = re.compile(rf"[a-z]+-{NONCE.pattern}")

Record = TypeVar("Record")
Plain = TypeVar("Plain", str, bool, float, list[Any], dict[Any, Any])
Several = TypeVar("Several", bound=Sized)


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
        raise ProtocolError(
            ProtocolReason.GARBAGE, "the test stream's name is not one of this program's"
        )
    return found


def _few(_name: str, found: Several) -> Several:
    if len(found) > MAX_TEST_PORTS:
        raise _wrong("a list", f"of at most {MAX_TEST_PORTS} entries")
    return found


def _known_system(_name: str, found: str) -> str:
    return found if found in SYSTEMS else ""


def _known_firewalls(_name: str, found: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(each for each in found if each in BY_FIREWALL)


Address = Annotated[str, _address]
# Port 0 means none; the test uses ports above 1023, which need no administrator.
_ANY, _FREE = range(65536), range(1024, 65536)
PortOrNone = Annotated[int, _ANY]
TestPorts = Annotated[tuple[int, ...], _few]
ByPort = dict[int, bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class Computer:
    """One of the two computers, and how LSL is set up there."""

    name: str
    system: Annotated[str, _known_system]  # Its `sys.platform`; empty if not in `SYSTEMS`.
    program: Annotated[str, _program]
    address: Address  # Address of its own end of the conversation.
    other: Address  # Address of the other end, as seen from this computer.
    is_near: bool  # Whether the other address is in the network of one of its adapters.
    session: str
    ports: Ports
    keeps_to_itself: bool = False  # Whether its LSL searches for streams on this computer only.
    asks_the_other: bool = False  # Whether its LSL asks the other computer directly (KnownPeers).
    # Firewalls of Linux that are known to be active.
    firewalls: Annotated[tuple[str, ...], _known_firewalls] = ()


@dataclass(frozen=True, slots=True)
class Stream:
    """A real stream that a computer has found, and the TCP port of its data."""

    name: str
    source_id: str
    uid: str
    host: str
    port: PortOrNone


@dataclass(frozen=True, slots=True)
class Targets:
    """Ports of one computer during a test; *discovery* is 0 if it could not be opened."""

    discovery: PortOrNone
    udp: TestPorts
    tcp: TestPorts


@dataclass(frozen=True, slots=True)
class Opened:
    """The ports and the test stream that one computer has opened for the other."""

    targets: Targets
    source_id: Annotated[str, _source_id]


@dataclass(slots=True)
class Arrivals:
    """What the test ports received from the other computer."""

    # Sender's addresses of received multicast; None if not tried.
    multicast: tuple[str, ...] | None = None
    # Whether LSL's discovery port received anything; None if it could not be opened.
    discovery: bool | None = None
    udp: ByPort = field(default_factory=ByPort)
    tcp: ByPort = field(default_factory=ByPort)


@dataclass(frozen=True, slots=True)
class Look:
    """How liblsl found and received the other's test stream."""

    by_multicast: bool | None = None  # Whether it was found by multicast; None if not tried.
    directly: bool = False  # Whether it was found by asking the other's address (KnownPeers).
    address: str = ""  # IPv4 or IPv6 address from which its data came; empty without data.
    received: bool = False
    # offset_s, round_trip_s: measurements of its clock; None if not possible.
    offset_s: float | None = None
    round_trip_s: float | None = None


@dataclass(frozen=True, slots=True)
class End:
    """One computer with all of its results."""

    computer: Computer
    arrivals: Arrivals
    look: Look
    own: tuple[Stream, ...] = ()  # Streams that are sent from this computer.
    seen: tuple[Stream, ...] = ()  # Streams of all other computers.
    # Uids of the other's streams whose data port could be opened from this computer.
    reached: tuple[str, ...] = ()


def as_message(end: End) -> Message:
    """Return the facts as a dictionary, for `read` and for scripts."""
    message = asdict(end)
    message["computer"]["ports"] = end.computer.ports._asdict()
    return message


def read(kind: type[Record], found: object) -> Record:
    """Parse a message of the other computer as a record, or a tuple of records.

    Raises
    ------
    ProtocolError
        ``GARBAGE``, if a field has a wrong type or size.
    """
    return cast("Record", _read("a message", kind, found))


def read_run(message: Message) -> str:
    """Return the number of the test; raises as `read` does."""
    found = str(message.get("run"))
    if not NONCE.fullmatch(found):
        raise ProtocolError(
            ProtocolReason.GARBAGE, "the test's number is not one of this program's"
        )
    return found


def _read(name: str, kind: Any, found: object) -> object:  # noqa: ANN401 - also unions
    origin, of = get_origin(kind), get_args(kind)
    if origin is Annotated:
        plain, check = of
        is_range = isinstance(check, range)
        return _number(name, found, check) if is_range else check(name, _read(name, plain, found))
    if origin is UnionType:
        # All optional fields are unions with None.
        return None if found is None else _read(name, of[0], found)
    if origin is tuple:
        return tuple(_read(name, of[0], each) for each in _plain(list, "an entry", found))
    if kind in _READERS:
        return _READERS[kind](name, found)
    fields = _plain(dict, "a message", found)
    hints = get_type_hints(kind, include_extras=True)
    return kind(**{each: _read(each, hint, fields.get(each)) for each, hint in hints.items()})


def _plain(kind: type[Plain], name: str, found: Any) -> Plain:  # noqa: ANN401 - looked at here
    types, fits, what = _PLAIN[kind]
    # The very type, because in Python true and false are integers, too.
    if type(found) not in types or not fits(found):
        raise _wrong(name, what)
    return kind(found)


def _number(name: str, found: object, within: range = _FREE) -> int:
    if type(found) is not int or found not in within:
        raise _wrong(name, f"a number from {within.start} to {within.stop - 1}")
    return found


def _by_port(name: str, found: object) -> ByPort:
    """Parse a mapping of ports to booleans; JSON has the ports as text."""
    ports = _few(name, _plain(dict, name, found))
    if not all(map(str.isdecimal, ports)):
        raise _wrong(name, "ports")
    return {int(port): _plain(bool, port, came) for port, came in ports.items()}


_PLAIN: dict[Any, tuple[tuple[type, ...], Callable[[Any], bool], str]] = {
    str: ((str,), lambda text: len(text) <= MAX_TEXT, f"text of at most {MAX_TEXT} characters"),
    bool: ((bool,), lambda _: True, "true or false"),
    # Compared before it is converted: an integer of JSON may be too large for a float.
    float: ((int, float), lambda number: abs(number) < MAX_NUMBER, "a finite number"),
    list: ((list,), lambda several: len(several) <= MAX_STREAMS, f"at most {MAX_STREAMS} entries"),
    dict: ((dict,), lambda _: True, "an object"),
}
_READERS: dict[Any, Callable[[str, object], object]] = {
    str: partial(_plain, str),
    bool: partial(_plain, bool),
    float: partial(_plain, float),
    int: _number,
    ByPort: _by_port,
}
