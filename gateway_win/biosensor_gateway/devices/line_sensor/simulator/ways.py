"""The ways by which a virtual board is reached."""

from __future__ import annotations

import socket
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Protocol

from websockets.asyncio.connection import broadcast
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.protocol import State

from biosensor_gateway.simulation.patient_port import PatientPort
from biosensor_gateway.simulation.tcp_port import LOOPBACK, KeptPort, break_off

_BUFFER_BYTES = 4096
_WEB_SOCKET_ROOM_BYTES = 1 << 15


class Way(Protocol):
    """A board's end of the link; for the world's loop."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """Fields of the settings that lead to it; known once it was opened."""
        ...

    async def open(self) -> None:
        """Be reachable, by the same name as before."""
        ...

    def write(self, data: bytes) -> bool:
        """Take all of it, or nothing; False where nobody listens."""
        ...

    def hang_up(self) -> None:
        """Cut the link and be unreachable until `open`."""
        ...

    def dispose(self) -> None:
        """Hang up for good."""
        ...


class Serial:
    """A serial port, or a TCP server.

    Parameters
    ----------
    tcp
        A TCP server also where there are pseudo-terminals; None = only where there are none.
    """

    def __init__(self, *, tcp: bool | None = None) -> None:
        options = {} if tcp is None else {"tcp": tcp}
        self._port = PatientPort(
            lambda _: None, lambda: None, buffer_bytes=_BUFFER_BYTES, **options
        )
        self.write = self._port.write
        self.hang_up = self._port.hang_up
        self.dispose = self._port.dispose

    @property
    def settings(self) -> Mapping[str, Any]:
        """The field ``port``."""
        return {"port": self._port.name}

    async def open(self) -> None:
        """Be reachable."""
        self._port.open()


class Udp:
    """Datagrams to a port of this computer, which nobody has yet."""

    def __init__(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind((LOOPBACK, 0))
            self._number = int(free.getsockname()[1])
        self._socket: socket.socket | None = None

    @property
    def settings(self) -> Mapping[str, Any]:
        """The field ``udp_port``."""
        return {"udp_port": self._number}

    async def open(self) -> None:
        """Send from now on."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect((LOOPBACK, self._number))

    def write(self, data: bytes) -> bool:
        """Send a datagram; the system tells of the one before whether somebody listened."""
        if self._socket is None:
            return False
        try:
            self._socket.send(data)
        except OSError:
            return False
        return True

    def hang_up(self) -> None:
        """Be off."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def dispose(self) -> None:
        """Be off."""
        self.hang_up()


class WebSocket:
    """A WebSocket server, a message for each line."""

    def __init__(self) -> None:
        self._port = KeptPort()
        self._server: Server | None = None
        self._listeners: set[ServerConnection] = set()
        self._is_wanted = False

    @property
    def settings(self) -> Mapping[str, Any]:
        """The field ``url``."""
        return {"url": f"ws://{LOOPBACK}:{self._port.number}/"}

    async def open(self) -> None:
        """Accept connections."""
        self._is_wanted = True
        server = await serve(
            self._serve, LOOPBACK, self._port.take(), compression=None, close_timeout=1.0
        )
        if not self._is_wanted:
            server.close()
            return
        self._server = server

    async def _serve(self, connection: ServerConnection) -> None:
        self._listeners.add(connection)
        try:
            await connection.wait_closed()
        finally:
            self._listeners.discard(connection)

    def write(self, data: bytes) -> bool:
        """Send a message to everybody who listens and reads."""
        reading = [
            each
            for each in self._listeners
            if each.state is State.OPEN
            and each.transport.get_write_buffer_size() < _WEB_SOCKET_ROOM_BYTES
        ]
        broadcast(reading, data.decode("latin-1"))
        return bool(reading)

    def hang_up(self) -> None:
        """Break off, and refuse connections."""
        self._is_wanted = False
        for each in tuple(self._listeners):
            with suppress(OSError):
                break_off(each.transport)
        if self._server is not None:
            self._server.close()
            self._server = None

    def dispose(self) -> None:
        """Hang up."""
        self.hang_up()
        self._port.give_back()
