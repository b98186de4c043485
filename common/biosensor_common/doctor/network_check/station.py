"""One of the two computers during the test: what it opens, sends and sees."""

from __future__ import annotations

import contextlib
import selectors
import socket
import sys
import threading
import time
from collections.abc import Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from ipaddress import ip_address, ip_network
from typing import Any, NamedTuple

from biosensor_common.doctor.check import Context
from biosensor_common.doctor.firewall import active_firewalls
from biosensor_common.doctor.interfaces import LSL_GROUP, adapters, is_free
from biosensor_common.doctor.lsl_checks import by_unicast
from biosensor_common.doctor.network_check.facts import (
    MAX_STREAMS,
    Arrivals,
    Computer,
    End,
    Look,
    Opened,
    Stream,
    Targets,
)
from biosensor_common.doctor.probe import Probe, ProbeError, SurveyedStream
from biosensor_common.lsl import api_file
from biosensor_common.lsl.api_file import PEERS, SESSION, Ports

SEARCH_S, LISTEN_S = 4.0, 3.0
CONNECT_S = 2.0
"""Time limit of a connection; without it, dropped packets would block forever."""
GROUPS = (LSL_GROUP, "224.0.0.183")
"""LSL's multicast groups that routers and switches treat differently."""
_LOOK_S, _LIFE_S = 30.0, 120.0
_ROUNDS, _PAUSE_S, _THREADS = 4, 0.15, 64
_POLL_S, _READ, _BACKLOG = 0.1, 512, 8
_ANY = "0.0.0.0"  # noqa: S104 - open for seconds, because a person asked for it
_BROADCAST = "255.255.255.255"
# The same reach as LSL's scope "site".
_HOPS = 24
# Ports below it belong to system services, not to streams.
_FIRST_FREE = 1024
_ASKING, _ANSWERING = "asking", "answering"
_MARK = b"biosensor-gateway network check "


class _Opened(NamedTuple):
    kind: str
    socket: socket.socket
    port: int


class OpenPorts:
    """Test ports, at which LSL would listen.

    Parameters
    ----------
    ports
        Ports of LSL on this computer. The lowest and the highest free ones are opened, which
        shows a firewall that lets in only a part of them.
    own, other
        Addresses of the two computers. Packets of other computers are not counted.
    adapters
        All addresses of this computer; LSL listens for multicast on each of them.
    """

    def __init__(
        self, ports: Ports, own: str, other: str, adapters: Sequence[str], mark: bytes
    ) -> None:
        self._ports, self._own, self._other, self._mark = ports, own, other, mark
        self._adapters = adapters
        self._opened: list[_Opened] = []
        self._ended = threading.Event()
        self._multicast: set[str] = set()
        self._came: set[tuple[str, int]] = set()

    @contextmanager
    def open(self) -> Generator[None]:
        """Open the ports."""
        with ExitStack() as stack:
            self._opened = [*self._discovery(stack), *self._several(stack)]
            listener = threading.Thread(target=self._listen, name="test-ports", daemon=True)
            listener.start()
            try:
                yield
            finally:
                self._ended.set()
                listener.join()

    @property
    def targets(self) -> Targets:
        """Return the ports to which the other computer should send."""
        (discovery,) = self._of("discovery") or [0]
        return Targets(discovery, tuple(self._of("udp")), tuple(self._of("tcp")))

    def arrivals(self, with_multicast: bool) -> Arrivals:
        """Return what was received until now."""
        discovery = self._of("discovery")
        udp, tcp = (
            {port: (kind, port) in self._came for port in self._of(kind)} for kind in ("udp", "tcp")
        )
        return Arrivals(
            tuple(sorted(self._multicast)) if with_multicast and discovery else None,
            ("discovery", discovery[0]) in self._came if discovery else None,
            udp,
            tcp,
        )

    def _of(self, kind: str) -> list[int]:
        return sorted(each.port for each in self._opened if each.kind == kind)

    def _discovery(self, stack: ExitStack) -> list[_Opened]:
        """Open the port that all LSL programs of this computer share."""
        port = self._ports.discovery
        try:
            every = stack.enter_context(_shared(_ANY, port))
            # Unicast packets go to the socket that is bound to the specific address.
            own = stack.enter_context(_shared(self._own, port))
        except OSError:
            return []
        for group in GROUPS:
            for address in self._adapters:
                membership = socket.inet_aton(group) + socket.inet_aton(address)
                # An adapter may have no multicast, or two addresses.
                with contextlib.suppress(OSError):
                    every.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        return [_Opened("multicast", every, port), _Opened("discovery", own, port)]

    def _several(self, stack: ExitStack) -> Iterator[_Opened]:
        numbers = range(self._ports.first, self._ports.last + 1)
        for kind, style in (("udp", socket.SOCK_DGRAM), ("tcp", socket.SOCK_STREAM)):
            taken: set[int] = set()
            for order in (numbers, reversed(numbers)):
                free = _first_free(style, (each for each in order if each not in taken))
                if free is not None:
                    port = free.getsockname()[1]
                    taken.add(port)
                    yield _Opened(kind, stack.enter_context(free), port)

    def _listen(self) -> None:
        with selectors.DefaultSelector() as selector:
            for each in self._opened:
                each.socket.setblocking(False)
                selector.register(each.socket, selectors.EVENT_READ, each)
            while not self._ended.is_set():
                for key, _ in selector.select(_POLL_S):
                    # On Windows, a UDP socket raises errors about packets that it has sent.
                    with contextlib.suppress(OSError):
                        self._note(key.data)

    def _note(self, opened: _Opened) -> None:
        if opened.kind == "tcp":
            connection, (address, _) = opened.socket.accept()
            connection.close()
        else:
            packet, (address, _) = opened.socket.recvfrom(_READ)
            if not packet.startswith(self._mark):
                return
        if opened.kind == "multicast":
            self._multicast.add(address)
        elif address == self._other:
            self._came.add((opened.kind, opened.port))


def _shared(address: str, port: int) -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind((address, port))
    except OSError:
        opened.close()
        raise
    return opened


def _first_free(style: int, numbers: Iterable[int]) -> socket.socket | None:
    for port in numbers:
        opened = socket.socket(socket.AF_INET, style)
        try:
            opened.bind((_ANY, port))
            if style == socket.SOCK_STREAM:
                opened.listen(_BACKLOG)
        except OSError:
            opened.close()
            continue
        return opened
    return None


def open_ports(other: str, ports: Iterable[int], own: str = "") -> set[int]:
    """Connect to TCP ports of the other computer, close at once, and return those that are open."""
    several = list(dict.fromkeys(ports))
    with ThreadPoolExecutor(_THREADS) as pool:
        found = pool.map(partial(_opens, own, other), several)
        return {port for port, is_open in zip(several, found, strict=True) if is_open}


def _opens(own: str, other: str, port: int) -> bool:
    try:
        socket.create_connection((other, port), CONNECT_S, (own, 0)).close()
    except OSError:
        return False
    return True


def _multicast(adapter: str, port: int, mark: bytes) -> None:
    with contextlib.suppress(OSError), _sender(adapter) as sender:
        sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        _to(sender, mark, _BROADCAST, port)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(adapter))
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, _HOPS)
        for group in GROUPS:
            _to(sender, mark, group, port)


def _sender(address: str) -> socket.socket:
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with contextlib.suppress(OSError):
        sender.bind((address, 0))
    return sender


def _to(sender: socket.socket, packet: bytes, address: str, port: int) -> None:
    # A packet that cannot be sent does not arrive, which the test reports.
    with contextlib.suppress(OSError):
        sender.sendto(packet, (address, port))


class Station:
    """The part of this computer in the test.

    Parameters
    ----------
    run
        Number of this test, for the names of its streams and session, and in its packets.
    is_asking
        Whether this is the asking side; packets contain it, because multicast loops back.
    """

    def __init__(
        self, context: Context, program: str, own: str, other: str, run: str, *, is_asking: bool
    ) -> None:
        self._own, self._other, self._real = own, other, context.config
        self._computer = _computer(self._real, program, own, other)
        self._config = api_file.changed(self._real, {SESSION: f"network-check-{run}"})
        roles = (_ASKING, _ANSWERING) if is_asking else (_ANSWERING, _ASKING)
        self._mark, awaited = (_MARK + f"{run} {role} ".encode("ascii") for role in roles)
        alone = self._computer.keeps_to_itself
        self._adapters = [] if alone else [each for one in adapters() for each in one.addresses]
        self._ports = OpenPorts(self._computer.ports, own, other, self._adapters, awaited)
        self._source_id = f"{roles[0]}-{run}"
        self._look = Look()
        self._streams = self.own_streams = tuple[Stream, ...]()
        self._reached: tuple[str, ...] = ()

    @contextmanager
    def open(self) -> Generator[None]:
        """Open test ports and a test stream; raises `ProbeError` if LSL cannot be used."""
        offered: dict[str, Any] = {"config": self._config, "source_id": self._source_id}
        with self._ports.open(), Probe("offer", _LIFE_S, **offered) as outlet:
            outlet.answer()
            yield

    @property
    def opened(self) -> Opened:
        """Return the ports to which the other one should send, and the stream it should find."""
        return Opened(self._ports.targets, self._source_id)

    def send(self, targets: Targets) -> None:
        """Send to the other's ports in each way that LSL uses."""
        # Any network may lose a packet, so several are sent.
        for _ in range(_ROUNDS):
            with _sender(self._own) as sender:
                for port in filter(None, (*targets.udp, targets.discovery)):
                    _to(sender, self._mark, self._other, port)
            if targets.discovery:
                for adapter in self._adapters:
                    _multicast(adapter, targets.discovery, self._mark)
            time.sleep(_PAUSE_S)
        open_ports(self._other, targets.tcp, self._own)

    def look(self, source_id: str) -> None:
        """Search for the other's test stream in both ways, and for all real streams."""
        asking = api_file.changed(self._config, {PEERS: "{}"})
        directly = by_unicast(self._config, self._other)
        with ThreadPoolExecutor(3) as pool:
            multicast = None
            if not self._computer.keeps_to_itself:
                multicast = pool.submit(_met, asking, source_id)
            unicast = pool.submit(_met, directly, source_id)
            listed = pool.submit(listed_streams, self._real)
            self._look = _looked(multicast.result() if multicast else None, unicast.result())
            self._streams = listed.result()
        self.own_streams = sent_from_here(self._streams)

    def knock(self, streams: tuple[Stream, ...]) -> None:
        """Connect to the data ports of the other's streams."""
        found = open_ports(self._other, (each.port for each in streams if each.port >= _FIRST_FREE))
        self._reached = tuple(each.uid for each in streams if each.port in found)

    def end(self) -> End:
        """Return the results of this computer."""
        arrivals = self._ports.arrivals(not self._computer.keeps_to_itself)
        own, seen = self.own_streams, self._streams
        return End(self._computer, arrivals, self._look, own, seen, self._reached)


def _met(config: str, source_id: str) -> dict[str, Any]:
    asked: dict[str, Any] = {"source_id": source_id, "search_s": SEARCH_S, "listen_s": LISTEN_S}
    try:
        with Probe("meet", _LOOK_S, config=config, **asked) as probe:
            return probe.answer()
    except ProbeError:
        return {"found": False}


def _looked(multicast: dict[str, Any] | None, unicast: dict[str, Any]) -> Look:
    """Merge the results of both ways; data received in either of them counts."""
    best = max((each for each in (multicast, unicast) if each is not None), key=_worth)
    return Look(
        None if multicast is None else bool(multicast["found"]),
        bool(unicast["found"]),
        str(best.get("address", "")),
        bool(best.get("received")),
        best.get("offset_s"),
        best.get("round_trip_s"),
    )


def _worth(met: dict[str, Any]) -> tuple[bool, bool, bool]:
    return bool(met.get("received")), met.get("offset_s") is not None, bool(met["found"])


def listed_streams(config: str) -> tuple[Stream, ...]:
    """Return all streams that LSL finds from this computer; none if LSL cannot be used."""
    try:
        with Probe("list", _LOOK_S, config=config, search_s=SEARCH_S) as probe:
            found = [SurveyedStream(**each) for each in probe.answer()["streams"]]
    except ProbeError:
        return ()
    found.sort(key=lambda each: (each.host, each.name))
    return tuple(
        Stream(each.name, each.source_id, each.uid, each.host, each.data_port)
        for each in found[:MAX_STREAMS]
    )


def sent_from_here(streams: Iterable[Stream]) -> tuple[Stream, ...]:
    """Return the streams of this computer; another one may have the same name."""
    named = [each for each in streams if each.host == socket.gethostname()]
    return tuple(each for each in named if not is_free(socket.SOCK_STREAM, each.port))


def _computer(config: str, program: str, own: str, other: str) -> Computer:
    return Computer(
        name=socket.gethostname(),
        system=sys.platform,
        program=program,
        address=own,
        other=other,
        is_near=_is_near(other),
        session=api_file.session(config),
        ports=api_file.ports(config),
        keeps_to_itself=api_file.keeps_to_itself(config),
        asks_the_other=other in _addresses(api_file.known_peers(config)),
        firewalls=active_firewalls(),
    )


def _addresses(peers: Iterable[str]) -> set[str]:
    found: set[str] = set()
    for peer in peers:
        with contextlib.suppress(OSError, UnicodeError):
            found.update(str(each[4][0]) for each in socket.getaddrinfo(peer, None))
    return found


def _is_near(other: str) -> bool:
    import psutil

    return any(
        ip_address(other) in ip_network(f"{each.address}/{each.netmask}", strict=False)
        for entries in psutil.net_if_addrs().values()
        for each in entries
        if each.family == socket.AF_INET and each.netmask
    )
