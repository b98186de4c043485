"""Two networks that are joined like two sites by a VPN: routed, late, and without multicast."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from tests.rigs.hosts.lan import DEADLINE_S, Host, HostsError, Lan
from tests.rigs.hosts.programs import Program

# As WireGuard's.
MTU = 1420
# A search of LSL asks every port of every peer at once.
_QUEUE_PACKETS = 5000
_ROUTER = 254
_SIDES = ("a", "b")
_CUT = """table inet cut {
    chain passing {
        type filter hook forward priority 0; policy drop;
    }
}
"""


class Delays(NamedTuple):
    """Seconds from the first network to the second, and back."""

    there_s: float
    back_s: float


class Link:
    """A router between two networks, with a relay that holds each packet back; a context manager.

    Every computer of both networks gets the router, address 254, as its gateway. Multicast is
    not routed. Packets are forwarded in the router's own namespace only.

    Raises
    ------
    HostsError
        On entering, where there are no namespaces or TUN devices.
    """

    def __init__(self, first: Lan, second: Lan, delays: Delays, folder: Path) -> None:
        self._lans = (first, second)
        self._delays, self._folder = delays, folder
        self._router = Host("vpn")
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            router = stack.enter_context(self._router)
            router.run("sysctl", "-qw", "net.ipv4.ip_forward=1", "net.ipv4.conf.all.rp_filter=0",
                       "net.ipv4.conf.default.rp_filter=0")  # fmt: skip
            for side, lan in zip(_SIDES, self._lans, strict=True):
                self._add_side(side, lan)
            delays = map(str, self._delays)
            relay = ("tests.rigs.hosts.relay", *(f"tun-{side}" for side in _SIDES), *delays)
            program = stack.enter_context(Program(router, os.environ, self._folder, *relay))
            _await_ready(program)
            for lan in self._lans:
                lan.route_by(_ROUTER)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def cut(self) -> None:
        """Let nothing through any more."""
        self._router.run("nft", "-f", "-", text=_CUT)

    def heal(self) -> None:
        """Let it through again."""
        self._router.run("nft", "delete", "table", "inet", "cut")

    def _add_side(self, side: str, lan: Lan) -> None:
        """Lead what comes from a network into a TUN device of its own."""
        port, tun, table = f"lan-{side}", f"tun-{side}", str(100 + _SIDES.index(side))
        lan.connect(self._router, _ROUTER, port)
        self._router.run("ip", "tuntap", "add", "dev", tun, "mode", "tun")
        self._router.run("ip", "link", "set", tun, "mtu", str(MTU))
        self._router.run("ip", "link", "set", tun, "txqueuelen", str(_QUEUE_PACKETS))
        self._router.run("ip", "link", "set", tun, "up")
        self._router.run("ip", "rule", "add", "iif", port, "lookup", table)
        self._router.run("ip", "route", "add", "default", "dev", tun, "table", table)


def _await_ready(program: Program) -> None:
    end = time.monotonic() + DEADLINE_S
    while "ready" not in program.log:
        if time.monotonic() > end:
            raise HostsError(f"the relay does not start: {program.last_words}")
        time.sleep(0.02)
