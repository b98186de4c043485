"""One of the two computers during the test: what it opens, sends and sees."""

from __future__ import annotations

import socket
import sys
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from ipaddress import ip_address, ip_network
from types import TracebackType
from typing import Any, Self

from biosensor_common.doctor.check import Context
from biosensor_common.doctor.network import adapters as interfaces
from biosensor_common.doctor.probe import Probe, ProbeError
from biosensor_common.doctor.streams import SurveyedStream, by_unicast
from biosensor_common.doctor.two_sided.facts import (
    MAX_STREAMS,
    Computer,
    End,
    Look,
    Stream,
)
from biosensor_common.doctor.two_sided.open_ports import OpenPorts, Targets, is_free
from biosensor_common.doctor.two_sided.remedies import active_firewalls
from biosensor_common.doctor.two_sided.sending import open_ports, send
from biosensor_common.lsl import api_file as lsl_text
from biosensor_common.lsl_config import LSL_SESSION

SEARCH_S, LISTEN_S = 4.0, 3.0
_LOOK_S = 30.0
_LIFE_S = 120.0
# Below it are services of the system, and no streams.
_FIRST_FREE = 1024
ASKING, ANSWERING = "asking", "answering"
_MARK = b"biosensor-gateway network check "


class Station:
    """What this computer does; a context manager, after which nothing of it is open.

    Parameters
    ----------
    context
        How the program takes part in LSL.
    program
        ``agent`` or ``node``.
    own, other
        Addresses of the conversation's two ends.
    run
        Of this test: names the test streams and their session, and marks the packets.
    is_asking
        Which of the two this is; the packets of both differ by it, for multicast comes back.
    """

    def __init__(
        self, context: Context, program: str, own: str, other: str, run: str, *, is_asking: bool
    ) -> None:
        self._own, self._other = own, other
        config = context.config
        self.computer = _computer(config, program, own, other)
        self._config = lsl_text.changed(config, {("lab", "SessionID"): f"network-check-{run}"})
        self._real = config
        roles = (ASKING, ANSWERING) if is_asking else (ANSWERING, ASKING)
        self._mark, awaited = (_MARK + f"{run} {role} ".encode("ascii") for role in roles)
        self._adapters = [] if self.computer.keeps_to_itself else _addresses()
        self._ports = OpenPorts(self.computer.ports, own, other, self._adapters, awaited)
        self._source_id = f"{roles[0]}-{run}"
        self._stack = ExitStack()
        self._look = Look()
        self._streams = self._own_streams = tuple[Stream, ...]()
        self._reached: tuple[str, ...] = ()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(self._ports)
            outlet = stack.enter_context(
                Probe("offer", _LIFE_S, config=self._config, source_id=self._source_id)
            )
            outlet.answer()
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    @property
    def targets(self) -> Targets:
        """The ports that the other one is to send to."""
        return self._ports.targets

    @property
    def source_id(self) -> str:
        """The test stream of this computer."""
        return self._source_id

    @property
    def own_streams(self) -> tuple[Stream, ...]:
        """Of the streams that `look` has found, those that are sent from here."""
        return self._own_streams

    def send(self, targets: Targets) -> None:
        """Send to the ports of the other one."""
        send(targets, self._own, self._other, self._adapters, self._mark)

    def look(self, source_id: str) -> None:
        """Look for the other's test stream, in both ways, and for all real streams."""
        asking = lsl_text.changed(self._config, {("lab", "KnownPeers"): "{}"})
        directly = by_unicast(self._config, self._other)
        with ThreadPoolExecutor(3) as pool:
            multicast = None
            if not self.computer.keeps_to_itself:
                multicast = pool.submit(_met, asking, source_id)
            unicast = pool.submit(_met, directly, source_id)
            listed = pool.submit(listed_streams, self._real)
            self._look = _looked(multicast.result() if multicast else None, unicast.result())
            self._streams = listed.result()
        self._own_streams = sent_from_here(self._streams)

    def knock(self, streams: tuple[Stream, ...]) -> None:
        """Open the data ports of the other's streams."""
        found = open_ports(self._other, (each.port for each in streams if each.port >= _FIRST_FREE))
        self._reached = tuple(each.uid for each in streams if each.port in found)

    def end(self) -> End:
        """Return all that was found out here."""
        return End(
            self.computer,
            self._ports.arrivals(not self.computer.keeps_to_itself),
            self._look,
            self._own_streams,
            self._streams,
            self._reached,
        )


def _met(config: str, source_id: str) -> dict[str, Any]:
    probe = Probe(
        "meet",
        _LOOK_S,
        config=config,
        source_id=source_id,
        search_s=SEARCH_S,
        listen_s=LISTEN_S,
    )
    try:
        with probe:
            return probe.answer()
    except ProbeError:
        return {"found": False}


def _looked(multicast: dict[str, Any] | None, unicast: dict[str, Any]) -> Look:
    """Put both ways together; what was received is received by any of them."""
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
    """Return all streams that LSL finds from here; none where LSL cannot be used."""
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
    """Return those of this computer; another one may have the same name."""
    named = [each for each in streams if each.host == socket.gethostname()]
    return tuple(each for each in named if not is_free(each.port))


def _computer(config: str, program: str, own: str, other: str) -> Computer:
    return Computer(
        name=socket.gethostname(),
        system=sys.platform,
        program=program,
        address=own,
        other=other,
        is_near=_is_near(other),
        session=lsl_text.value(config, "lab", "SessionID") or LSL_SESSION,
        ports=lsl_text.ports(config),
        keeps_to_itself=lsl_text.value(config, "multicast", "ResolveScope") == "machine",
        asks_the_other=other in _peers(config),
        firewalls=active_firewalls(),
    )


def _peers(config: str) -> set[str]:
    found: set[str] = set()
    for peer in lsl_text.value(config, "lab", "KnownPeers").strip("{}").split(","):
        if peer.strip():
            try:
                found.update(str(each[4][0]) for each in socket.getaddrinfo(peer.strip(), None))
            except (OSError, UnicodeError):
                continue
    return found


def _addresses() -> list[str]:
    return [address for each in interfaces() for address in each.addresses]


def _is_near(other: str) -> bool:
    import psutil

    for entries in psutil.net_if_addrs().values():
        for each in entries:
            if each.family == socket.AF_INET and each.netmask:
                network = ip_network(f"{each.address}/{each.netmask}", strict=False)
                if ip_address(other) in network:
                    return True
    return False
