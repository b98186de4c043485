"""Ports that are open for the length of a test, and what came in there from one address."""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

from biosensor_common.doctor.network import LSL_GROUP
from biosensor_common.doctor.two_sided.facts import Arrivals
from biosensor_common.lsl.api_file import Ports

GROUPS = (LSL_GROUP, "224.0.0.183")
"""Those of LSL's that routers and switches treat differently."""
_POLL_S, _READ, _BACKLOG = 0.1, 512, 8
_ANY = "0.0.0.0"  # noqa: S104 - open for seconds, because a person asked for it


@dataclass(frozen=True, slots=True)
class Targets:
    """Where one computer can be reached during a test; *discovery* is 0 if it cannot be had."""

    discovery: int
    udp: tuple[int, ...]
    tcp: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class _Opened:
    kind: str
    socket: socket.socket
    port: int = field(default=0)


class OpenPorts:
    """Listens at the ports that LSL would; a context manager.

    Parameters
    ----------
    ports
        Of LSL on this computer. Tried are the lowest and the highest that are free, so that a
        firewall that lets in a part of them shows.
    own, other
        Addresses of the two computers. What others send is not counted.
    adapters
        All addresses of this computer; LSL listens for multicast on each.
    mark
        With what each packet of the other one begins.
    """

    def __init__(
        self, ports: Ports, own: str, other: str, adapters: Sequence[str], mark: bytes
    ) -> None:
        self._ports, self._own, self._other, self._mark = ports, own, other, mark
        self._adapters = adapters
        self._stack = ExitStack()
        self._opened: list[_Opened] = []
        self._ended = threading.Event()
        self._multicast: set[str] = set()
        self._came: set[tuple[str, int]] = set()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._opened = [*self._discovery(stack), *self._several(stack)]
            listener = threading.Thread(target=self._listen, name="test-ports", daemon=True)
            listener.start()
            stack.callback(listener.join)
            stack.callback(self._ended.set)
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
        """Where the other computer is to send to."""
        discovery = self._of("discovery")
        return Targets(
            discovery[0] if discovery else 0, tuple(self._of("udp")), tuple(self._of("tcp"))
        )

    def arrivals(self, with_multicast: bool) -> Arrivals:
        """Return what has come in until now."""
        discovery = self._of("discovery")
        return Arrivals(
            tuple(sorted(self._multicast)) if with_multicast and discovery else None,
            ("discovery", discovery[0]) in self._came if discovery else None,
            {port: ("udp", port) in self._came for port in self._of("udp")},
            {port: ("tcp", port) in self._came for port in self._of("tcp")},
        )

    def _of(self, kind: str) -> list[int]:
        return sorted(each.port for each in self._opened if each.kind == kind)

    def _discovery(self, stack: ExitStack) -> list[_Opened]:
        """Open the port that all LSL programs of this computer share."""
        try:
            every = stack.enter_context(_shared(_ANY, self._ports.discovery))
            # What is sent to one address alone goes to who has bound to that one.
            own = stack.enter_context(_shared(self._own, self._ports.discovery))
        except OSError:
            return []
        for group in GROUPS:
            for address in self._adapters:
                membership = socket.inet_aton(group) + socket.inet_aton(address)
                # An adapter may have no multicast, or two addresses.
                with contextlib.suppress(OSError):
                    every.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        return [
            _Opened("multicast", every, self._ports.discovery),
            _Opened("discovery", own, self._ports.discovery),
        ]

    def _several(self, stack: ExitStack) -> Iterable[_Opened]:
        numbers = range(self._ports.first, self._ports.last + 1)
        for kind, style in (("udp", socket.SOCK_DGRAM), ("tcp", socket.SOCK_STREAM)):
            taken: set[int] = set()
            for order in (numbers, reversed(numbers)):
                free = _first_free(style, (each for each in order if each not in taken))
                if free is not None:
                    taken.add(free.getsockname()[1])
                    yield _Opened(kind, stack.enter_context(free), free.getsockname()[1])

    def _listen(self) -> None:
        with selectors.DefaultSelector() as selector:
            for each in self._opened:
                each.socket.setblocking(False)
                selector.register(each.socket, selectors.EVENT_READ, each)
            while not self._ended.is_set():
                for key, _ in selector.select(_POLL_S):
                    # Windows tells a UDP socket what became of packets that it sent.
                    with contextlib.suppress(OSError):
                        self._note(key.data)

    def _note(self, opened: _Opened) -> None:
        if opened.kind == "tcp":
            connection, (address, _) = opened.socket.accept()
            connection.close()
            if address == self._other:
                self._came.add((opened.kind, opened.port))
            return
        packet, (address, _) = opened.socket.recvfrom(_READ)
        if not packet.startswith(self._mark):
            return
        if opened.kind == "multicast":
            self._multicast.add(address)
        elif address == self._other:
            self._came.add((opened.kind, opened.port))


def is_free(port: int) -> bool:
    """Whether no program of this computer has a TCP port; a firewall has no say in it."""
    opened = _first_free(socket.SOCK_STREAM, [port])
    if opened is None:
        return False
    opened.close()
    return True


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
