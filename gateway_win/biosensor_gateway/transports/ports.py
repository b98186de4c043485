"""Ports of this computer by which a device is asked for, and to which it connects and sends."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from typing import Protocol

from biosensor_gateway.transports.link import Address
from biosensor_gateway.transports.udp_port import Take, UdpPort

ASKING, CONTROL, DATA = "asking", "control", "data"
"""What a capture calls them."""
_ANY_PORT = 9


class Asking(Protocol):
    """A UDP port to ask from, also everybody in the network."""

    def sendto(self, data: bytes, addr: Address) -> None:
        """Send a datagram."""
        ...

    def close(self) -> None:
        """Let it go."""
        ...


class Accepting(Protocol):
    """A TCP port that waits for a device."""

    @property
    def number(self) -> int:
        """Number of the port."""
        ...

    def close(self) -> None:
        """Take no more connections."""
        ...


class DataPort(Protocol):
    """A UDP port for a device's data; see `UdpPort`."""

    @property
    def number(self) -> int:
        """Number of the port."""
        ...

    def send(self, data: bytes, to: Address) -> None:
        """Send a datagram; where nobody listens, nothing happens."""
        ...

    def listen(self, take: Take, lost: Callable[[OSError], object]) -> None:
        """Hand on all datagrams until `end`."""
        ...

    def end(self) -> None:
        """Let it go."""
        ...


class Ports(Protocol):
    """All of them for one connection of one device; each raises OSError if it cannot be had."""

    async def asking(self, take: Callable[[bytes, Address], None]) -> Asking:
        """Open the port to ask from; `take` gets the answers."""
        ...

    def towards(self, host: str) -> str:
        """Return this computer's address in the network of a host; nothing is sent."""
        ...

    async def accepting(self, made: Callable[[], asyncio.Protocol], here: str) -> Accepting:
        """Wait for connections at an address of this computer."""
        ...

    def data(self, here: str) -> DataPort:
        """Open the port for data at an address of this computer."""
        ...


class _Answers(asyncio.DatagramProtocol):
    """Hands each datagram on."""

    def __init__(self, take: Callable[[bytes, Address], None]) -> None:
        self._take = take

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._take(data, (addr[0], addr[1]))

    def error_received(self, exc: Exception) -> None:
        """Pass over it: where nobody listens (yet), some systems say so at the next call."""


class _Accepting:
    def __init__(self, server: asyncio.Server) -> None:
        self._server = server
        self.close = server.close

    @property
    def number(self) -> int:
        number: int = self._server.sockets[0].getsockname()[1]
        return number


class _SystemPorts:
    """Those of the operating system."""

    async def asking(self, take: Callable[[bytes, Address], None]) -> Asking:
        """Open the port to ask from; see :class:`Ports`."""
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(
            lambda: _Answers(take),
            ("0.0.0.0", 0),  # noqa: S104 - answers come by whatever network there is
            allow_broadcast=True,
        )
        return transport

    def towards(self, host: str) -> str:
        """Return this computer's address there; see :class:`Ports`."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((host, _ANY_PORT))
            address: str = probe.getsockname()[0]
            return address

    async def accepting(self, made: Callable[[], asyncio.Protocol], here: str) -> Accepting:
        """Wait for connections; see :class:`Ports`."""
        return _Accepting(await asyncio.get_running_loop().create_server(made, here, 0))

    def data(self, here: str) -> DataPort:
        """Open the port for data; see :class:`Ports`."""
        return UdpPort(here)


SYSTEM_PORTS = _SystemPorts()
