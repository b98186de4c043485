"""UDP and TCP ports of this computer for devices that connect or send to it."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import Callable
from functools import partial
from typing import Protocol

from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports.link import Address, Receiver
from biosensor_gateway.transports.threads import in_daemon_thread

Take = Callable[[bytes, float, Address], object]
_LOOK_S = 0.2
"""Within this time the reading ends."""
_END_LIMIT_S = 1.0
_BUFFER_BYTES = 1 << 20
"""What the system keeps for an agent that does not run."""


class UdpPort:
    """A UDP port that is bound on creation.

    Parameters
    ----------
    host
        Address of this computer to bind to; empty for all.
    port
        0 for any free port.

    Raises
    ------
    OSError
        The port is not available.
    """

    def __init__(self, host: str = "", port: int = 0) -> None:
        self._closing = False
        self._reading: threading.Thread | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.settimeout(_LOOK_S)
            with contextlib.suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
            self._socket.bind((host, port))
        except OSError:
            self._socket.close()
            raise

    @property
    def number(self) -> int:
        """Number of the port."""
        number: int = self._socket.getsockname()[1]
        return number

    def send(self, data: bytes, to: Address) -> None:
        """Send a datagram; no error if nobody listens."""
        with contextlib.suppress(OSError):
            self._socket.sendto(data, to)

    def listen(self, take: Take, lost: Callable[[OSError], object]) -> None:
        """Pass on all datagrams in the running event loop until `end`; a thread reads them.

        Parameters
        ----------
        take
            Called with the bytes, the LSL time of their arrival, and their sender.
        lost
            Called with the error if the port fails.
        """
        loop = asyncio.get_running_loop()

        def read() -> None:
            # A loop that has ended takes nothing.
            with contextlib.suppress(RuntimeError):
                try:
                    self._read_forever(partial(loop.call_soon_threadsafe, take))
                except OSError as error:
                    loop.call_soon_threadsafe(lost, error)

        self._reading = threading.Thread(target=read, daemon=True)
        self._reading.start()

    def _read_forever(self, take: Take) -> None:
        receiver = Receiver(self._socket)
        with self._socket:
            while not self._closing:
                try:
                    data, sender = receiver.read_from()
                except (TimeoutError, ConnectionResetError):
                    # Windows tells so that something which was sent elsewhere did not arrive.
                    continue
                if not self._closing:
                    take(data, LSL_CLOCK(), sender)

    def end(self) -> None:
        """Stop reading and close the port, without waiting."""
        self._closing = True
        if self._reading is None:
            self._socket.close()

    async def close(self) -> None:
        """Stop reading and wait until the port is free, at most for a second."""
        self.end()
        if self._reading is not None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_END_LIMIT_S):
                    await in_daemon_thread(self._reading.join)


ASKING, CONTROL, DATA = "asking", "control", "data"
"""What a capture calls them."""
_ANY_PORT = 9


class Accepting(Protocol):
    """A TCP port that waits for a device."""

    @property
    def number(self) -> int:
        """Number of the port."""
        ...

    def close(self) -> None:
        """Stop accepting connections."""
        ...


class DataPort(Protocol):
    """A UDP port for a device's data; see `UdpPort`."""

    @property
    def number(self) -> int:
        """Number of the port."""
        ...

    def send(self, data: bytes, to: Address) -> None:
        """Send a datagram; no error if nobody listens."""
        ...

    def listen(self, take: Take, lost: Callable[[OSError], object]) -> None:
        """Pass on all datagrams until `end`."""
        ...

    def end(self) -> None:
        """Close the port."""
        ...


class Ports(Protocol):
    """Opens the ports for one connection of one device; raises OSError if one is unavailable."""

    async def asking(self, take: Callable[[bytes, Address], None]) -> asyncio.DatagramTransport:
        """Open a port for queries, also broadcasts; `take` is called with the answers."""
        ...

    def towards(self, host: str) -> str:
        """Return this computer's address in the network of a host, without sending anything."""
        ...

    async def accepting(self, made: Callable[[], asyncio.Protocol], here: str) -> Accepting:
        """Accept connections at an address of this computer."""
        ...

    def data(self, here: str) -> DataPort:
        """Open the port for data at an address of this computer."""
        ...


class _Answers(asyncio.DatagramProtocol):
    """Passes each datagram on."""

    def __init__(self, take: Callable[[bytes, Address], None]) -> None:
        self._take = take

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._take(data, (addr[0], addr[1]))

    def error_received(self, exc: Exception) -> None:
        """Ignore it: if nobody listens (yet), some systems report it at the next call."""


class _Accepting:
    def __init__(self, server: asyncio.Server) -> None:
        self._server = server
        self.close = server.close

    @property
    def number(self) -> int:
        number: int = self._server.sockets[0].getsockname()[1]
        return number


class _SystemPorts:
    """Ports of the operating system."""

    async def asking(self, take: Callable[[bytes, Address], None]) -> asyncio.DatagramTransport:
        """Open the port for queries; see :class:`Ports`."""
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(
            lambda: _Answers(take),
            ("0.0.0.0", 0),  # noqa: S104 - answers come by whatever network there is
            allow_broadcast=True,
        )
        return transport

    def towards(self, host: str) -> str:
        """Return this computer's address; see :class:`Ports`."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((host, _ANY_PORT))
            address: str = probe.getsockname()[0]
            return address

    async def accepting(self, made: Callable[[], asyncio.Protocol], here: str) -> Accepting:
        """Accept connections; see :class:`Ports`."""
        return _Accepting(await asyncio.get_running_loop().create_server(made, here, 0))

    def data(self, here: str) -> DataPort:
        """Open the port for data; see :class:`Ports`."""
        return UdpPort(here)


SYSTEM_PORTS = _SystemPorts()
