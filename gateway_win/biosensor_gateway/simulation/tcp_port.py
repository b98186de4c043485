"""A TCP port of the loopback interface that stays reserved while it is closed."""

from __future__ import annotations

import asyncio
import socket
import struct
import sys
from collections.abc import Callable
from contextlib import suppress

from biosensor_common.errors import TransportError, TransportReason

LOOPBACK = "127.0.0.1"
_LOOK_EVERY_S = 0.01
_RESET_AT_CLOSE = struct.pack("ii", 1, 0)


class TcpPort:
    """A port that can be opened and shut; all methods must run in the world's event loop.

    Parameters
    ----------
    connected
        Called with each accepted, non-blocking connection.
    send_buffer_bytes
        System buffer for clients that do not read; None for the default size.
    """

    def __init__(
        self, connected: Callable[[socket.socket], None], send_buffer_bytes: int | None = None
    ) -> None:
        self._connected = connected
        self._send_buffer_bytes = send_buffer_bytes
        self._socket: socket.socket | None = None
        self._number = 0
        self._next_look: asyncio.TimerHandle | None = None

    @property
    def number(self) -> int:
        """The port number, which stays the same when reopened; 0 before `bind`."""
        return self._number

    @property
    def is_open(self) -> bool:
        """Whether connections are accepted."""
        return self._next_look is not None

    def bind(self) -> None:
        """Reserve the port without listening, so connections are refused.

        Raises
        ------
        TransportError
            BUSY if the port is not available.
        """
        if self._socket is None:
            self._socket = self._bound()
            self._number = int(self._socket.getsockname()[1])

    def open(self) -> None:
        """Start accepting connections.

        Raises
        ------
        TransportError
            As for `bind`.
        """
        if not self.is_open:
            self.bind()
            if self._socket is not None:
                # Connections before the first accept wait in the backlog.
                self._socket.listen()
                self._look(self._socket)

    def shut(self) -> None:
        """Refuse new connections but keep the port number; existing connections stay.

        Raises
        ------
        TransportError
            As for `bind`.
        """
        if self.is_open:
            self.close()
            self.bind()

    def close(self) -> None:
        """Release the port."""
        if self._next_look is not None:
            self._next_look.cancel()
            self._next_look = None
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _look(self, listening: socket.socket) -> None:
        # Not with asyncio's server, which loses connections accepted while it closes (`_attach`
        # asserts that it is open), as does a cancelled `sock_accept`.
        loop = asyncio.get_running_loop()
        self._next_look = loop.call_later(_LOOK_EVERY_S, self._look, listening)
        with suppress(BlockingIOError, ConnectionAbortedError):
            while True:
                connection, _ = listening.accept()
                connection.setblocking(False)
                self._connected(connection)

    def _bound(self) -> socket.socket:
        bound = socket.socket()
        if sys.platform != "win32":  # on Windows it would let others use the same port
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if self._send_buffer_bytes is not None:
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, self._send_buffer_bytes)
        bound.setblocking(False)
        try:
            bound.bind((LOOPBACK, self._number))
        except OSError as error:
            bound.close()
            message = f"port {self._number} of {LOOPBACK} is not available for a virtual device"
            raise TransportError(TransportReason.BUSY, f"{message}: {error}") from error
        return bound


class KeptPort:
    """Reserves a port number of the loopback interface while the server on it is closed.

    This is for servers that bind the port themselves, because the system would reuse a free port
    for any new connection.
    """

    def __init__(self) -> None:
        self._number = 0
        self._place: socket.socket | None = None

    @property
    def number(self) -> int:
        """The port number, which stays the same; 0 before `take`."""
        return self._number

    def take(self) -> int:
        """Reserve a port, and return its number."""
        if self._place is None:
            self._place = socket.socket()
            if sys.platform != "win32":
                # With this option on both sockets, the server can bind it, too; this one never
                # listens.
                self._place.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._place.bind((LOOPBACK, self._number))
            self._number = int(self._place.getsockname()[1])
            if sys.platform == "win32":  # on Windows the server could not bind it
                self._place.close()
        return self._number

    def give_back(self) -> None:
        """Release the port."""
        if self._place is not None:
            self._place.close()
            self._place = None


def break_off(transport: asyncio.Transport) -> None:
    """Abort a connection with an RST, like a killed process."""
    connection = transport.get_extra_info("socket")
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET_AT_CLOSE)
    transport.abort()
