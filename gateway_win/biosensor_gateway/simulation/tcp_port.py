"""A TCP port of loopback that stays a virtual device's own while it refuses everybody."""

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
    """A port that can be opened and shut; its methods are for the world's loop.

    Parameters
    ----------
    connected
        Gets each connection that was accepted, which does not block.
    send_buffer_bytes
        What the system keeps for whoever does not read; None = its usual size.
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
        """The port's number, the same over all openings; 0 before `bind`."""
        return self._number

    @property
    def is_open(self) -> bool:
        """Whether connections are accepted."""
        return self._next_look is not None

    def bind(self) -> None:
        """Take the port without listening on it: connections are refused.

        Raises
        ------
        TransportError
            BUSY if the port cannot be had.
        """
        if self._socket is None:
            self._socket = self._bound()
            self._number = int(self._socket.getsockname()[1])

    def open(self) -> None:
        """Accept connections from now on.

        Raises
        ------
        TransportError
            As for `bind`.
        """
        if not self.is_open:
            self.bind()
            if self._socket is not None:
                # Who comes before the first look waits in the backlog.
                self._socket.listen()
                self._look(self._socket)

    def shut(self) -> None:
        """Refuse connections from now on, and keep the number; those that stand are left alone.

        Raises
        ------
        TransportError
            As for `bind`.
        """
        if self.is_open:
            self.close()
            self.bind()

    def close(self) -> None:
        """Give the port back."""
        if self._next_look is not None:
            self._next_look.cancel()
            self._next_look = None
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _look(self, listening: socket.socket) -> None:
        # Not by asyncio's server: it loses who is accepted as it closes (`_attach` asserts that
        # it is open), and so does a `sock_accept` that is cancelled.
        loop = asyncio.get_running_loop()
        self._next_look = loop.call_later(_LOOK_EVERY_S, self._look, listening)
        with suppress(BlockingIOError, ConnectionAbortedError):
            while True:
                connection, _ = listening.accept()
                connection.setblocking(False)
                self._connected(connection)

    def _bound(self) -> socket.socket:
        bound = socket.socket()
        if sys.platform != "win32":  # there it would let others take the same port
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if self._send_buffer_bytes is not None:
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, self._send_buffer_bytes)
        bound.setblocking(False)
        try:
            bound.bind((LOOPBACK, self._number))
        except OSError as error:
            bound.close()
            message = f"port {self._number} of {LOOPBACK} cannot be had for a virtual device"
            raise TransportError(TransportReason.BUSY, f"{message}: {error}") from error
        return bound


class KeptPort:
    """The number of a port of loopback that nobody else gets while the server on it is shut.

    For servers of others, which bind it themselves: the system hands a free port to whoever
    connects next.
    """

    def __init__(self) -> None:
        self._number = 0
        self._place: socket.socket | None = None

    @property
    def number(self) -> int:
        """The same over all openings; 0 before `take`."""
        return self._number

    def take(self) -> int:
        """Keep a port from now on, and return its number."""
        if self._place is None:
            self._place = socket.socket()
            if sys.platform != "win32":
                # The server, which does so too, may have it as well: this one never listens.
                self._place.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._place.bind((LOOPBACK, self._number))
            self._number = int(self._place.getsockname()[1])
            if sys.platform == "win32":  # there the server could not have it
                self._place.close()
        return self._number

    def give_back(self) -> None:
        """Keep it no longer."""
        if self._place is not None:
            self._place.close()
            self._place = None


def break_off(transport: asyncio.Transport) -> None:
    """End a connection with an RST, as a process does that is killed."""
    connection = transport.get_extra_info("socket")
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET_AT_CLOSE)
    transport.abort()
