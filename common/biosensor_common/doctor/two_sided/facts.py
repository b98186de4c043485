"""The facts that each of the two computers tells of itself and of what reached it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

from biosensor_common.doctor.check import AGENT, NODE
from biosensor_common.doctor.two_sided.channel import Message
from biosensor_common.doctor.two_sided.reading import Reader, entries
from biosensor_common.lsl.api_file import Ports

PROGRAMS = (AGENT, NODE)
SYSTEMS = ("win32", "linux", "darwin")
FIREWALLS = ("ufw", "firewalld", "nftables")
MAX_STREAMS = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class Computer:
    """One of the two computers, and how LSL is set up there.

    Attributes
    ----------
    name
        Its host name.
    system
        As ``sys.platform`` has it; empty for any but those of `SYSTEMS`.
    program
        ``agent`` or ``node``.
    address
        Its own end of the conversation, by itself.
    other
        The other end, as it is seen from here.
    is_near
        Whether the other's address is in a network of one of its adapters.
    session
        LSL session.
    keeps_to_itself
        Whether its LSL looks for streams on this computer only.
    asks_the_other
        Whether its LSL asks the other one directly (KnownPeers).
    firewalls
        Which of `FIREWALLS` are on, as far as anybody can see.
    """

    name: str
    system: str
    program: str
    address: str
    other: str
    is_near: bool
    session: str
    ports: Ports
    keeps_to_itself: bool = False
    asks_the_other: bool = False
    firewalls: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Stream:
    """A real stream as a computer sees it; *port* is the TCP port of its data."""

    name: str
    source_id: str
    uid: str
    host: str
    port: int


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
    udp: dict[int, bool] = field(default_factory=dict[int, bool])
    tcp: dict[int, bool] = field(default_factory=dict[int, bool])


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
    """Return what `read_end` understands."""
    return asdict(end) | {"computer": computer_message(end.computer)}


def computer_message(computer: Computer) -> Message:
    """Return what `read_computer` understands."""
    return asdict(computer) | {"ports": computer.ports._asdict()}


def read_computer(message: object) -> Computer:
    """Read what the other computer says of itself.

    Raises
    ------
    ProtocolError
        ``GARBAGE``.
    """
    read = Reader(message)
    system = read.text("system")
    ports = read.inner("ports")
    return Computer(
        name=read.text("name"),
        system=system if system in SYSTEMS else "",
        program=read.one_of("program", PROGRAMS),
        address=read.address("address"),
        other=read.address("other"),
        is_near=read.flag("is_near"),
        session=read.text("session"),
        ports=Ports(ports.port("discovery"), ports.port("first"), ports.port("last")),
        keeps_to_itself=read.flag("keeps_to_itself"),
        asks_the_other=read.flag("asks_the_other"),
        firewalls=tuple(each for each in read.texts("firewalls", 8) if each in FIREWALLS),
    )


def read_stream(message: object) -> Stream:
    """Read a stream; raises as `read_computer` does."""
    read = Reader(message)
    return Stream(
        read.text("name"),
        read.text("source_id"),
        read.text("uid"),
        read.text("host"),
        read.number("port", 0, 65535),
    )


def read_streams(message: object) -> tuple[Stream, ...]:
    """Read a list of streams; raises as `read_computer` does."""
    return tuple(read_stream(each) for each in entries(message, MAX_STREAMS))


def read_end(message: object) -> End:
    """Read what the other computer has found out; raises as `read_computer` does."""
    read = Reader(message)
    arrivals, look = read.inner("arrivals"), read.inner("look")
    multicast = arrivals.value("multicast")
    return End(
        read_computer(read.value("computer")),
        Arrivals(
            None if multicast is None else tuple(arrivals.texts("multicast", 16)),
            arrivals.flag_or_none("discovery"),
            arrivals.flags_by_port("udp"),
            arrivals.flags_by_port("tcp"),
        ),
        Look(
            look.flag_or_none("by_multicast"),
            look.flag("directly"),
            look.text("address"),
            look.flag("received"),
            look.real_or_none("offset_s"),
            look.real_or_none("round_trip_s"),
        ),
        read_streams(read.value("own")),
        read_streams(read.value("seen")),
        tuple(read.texts("reached", MAX_STREAMS)),
    )
