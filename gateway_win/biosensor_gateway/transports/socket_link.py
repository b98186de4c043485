"""Byte streams over sockets, whatever family: what TCP and RFCOMM links share.

Sockets block in threads of their own: Windows' event loop knows no Bluetooth
sockets, and a thread stamps bytes when they arrive, not when the loop gets to
them. The threads are daemons: a connection that hangs must not keep the agent
from ending.
"""

from __future__ import annotations

import asyncio
import contextlib
import queue
import socket
import threading
from collections.abc import Callable

from pylsl import local_clock

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.transports.link import Received
from biosensor_gateway.transports.threads import in_daemon_thread

OPEN_TIMEOUT_S = 20.0
WRITE_TIMEOUT_S = 2.0
CLOSE_TIMEOUT_S = 1.0
FAREWELL_S = 0.5
"""How long a closing link waits for the other side to hang up, too."""

_READ_SIZE = 65536


class SocketLink:
    """A connected socket as a :class:`~biosensor_gateway.transports.link.ByteLink`.

    Parameters
    ----------
    name
        What error messages call it.
    connect
        Makes the connected, blocking socket; runs in a thread of its own.
    open_error
        Turns what `connect` raised into the error that a user sees.
    """

    def __init__(
        self,
        name: str,
        connect: Callable[[], socket.socket],
        open_error: Callable[[OSError], TransportError],
    ) -> None:
        self._name = name
        self._connect = connect
        self._open_error = open_error
        self._socket: socket.socket | None = None
        self._incoming: asyncio.Queue[Received | TransportError] = asyncio.Queue()
        self._outgoing: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._closing = False
        self._threads: tuple[threading.Thread, ...] = ()

    async def open(self) -> None:
        """Connect; see :class:`~biosensor_gateway.transports.link.ByteLink`."""
        try:
            async with asyncio.timeout(OPEN_TIMEOUT_S):
                connected = await in_daemon_thread(self._open_socket)
        except TimeoutError as error:
            self._closing = True
            raise self._open_error(error) from error
        except OSError as error:
            raise self._open_error(error) from error
        loop = asyncio.get_running_loop()
        self._threads = (
            threading.Thread(target=self._read_forever, args=(connected, loop), daemon=True),
            threading.Thread(target=self._write_forever, args=(connected, loop), daemon=True),
        )
        for thread in self._threads:
            thread.start()

    async def read(self) -> Received:
        """Wait for the next bytes; raise ``LOST`` when the connection has ended."""
        item = await self._incoming.get()
        if isinstance(item, TransportError):
            self._incoming.put_nowait(item)
            raise item
        return item

    def write(self, data: bytes) -> None:
        """Queue bytes for the writing thread."""
        self._outgoing.put(data)

    async def close(self) -> None:
        """Let the writer send what is queued, then close the socket."""
        self._closing = True
        self._outgoing.put(None)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_TIMEOUT_S + FAREWELL_S):
                await in_daemon_thread(self._end)

    def _open_socket(self) -> socket.socket:
        connected = self._connect()
        # One timeout serves both ways: the reader tries again, the writer gives up.
        connected.settimeout(WRITE_TIMEOUT_S)
        self._socket = connected
        if self._closing:
            # Nobody waits for it any more; held open, it would refuse the next attempt.
            connected.close()
        return connected

    def _end(self) -> None:
        if self._socket is None:
            return
        if self._threads:
            reader, writer = self._threads
            writer.join(CLOSE_TIMEOUT_S)
            reader.join(FAREWELL_S)
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            reader.join()
        self._socket.close()

    def _read_forever(self, connected: socket.socket, loop: asyncio.AbstractEventLoop) -> None:
        try:
            while data := self._receive(connected):
                if not self._closing:
                    self._deliver(loop, Received(data, local_clock()))
            self._lost(loop, "the other side closed it")
        except OSError as error:
            self._lost(loop, error)

    @staticmethod
    def _receive(connected: socket.socket) -> bytes:
        while True:
            with contextlib.suppress(TimeoutError):
                return connected.recv(_READ_SIZE)

    def _write_forever(self, connected: socket.socket, loop: asyncio.AbstractEventLoop) -> None:
        try:
            while (data := self._outgoing.get()) is not None:
                connected.sendall(data)
            # Closing at once, with bytes unread, would make the system throw away what is
            # still to be sent; the reader goes on until the other side hangs up.
            connected.shutdown(socket.SHUT_WR)
        except OSError as error:
            self._lost(loop, error)

    def _lost(self, loop: asyncio.AbstractEventLoop, cause: object) -> None:
        if not self._closing:
            message = f"{self._name}: the link was cut ({cause})"
            self._deliver(loop, TransportError(TransportReason.LOST, message))

    def _deliver(self, loop: asyncio.AbstractEventLoop, item: Received | TransportError) -> None:
        try:
            loop.call_soon_threadsafe(self._incoming.put_nowait, item)
        except RuntimeError:
            # The loop has ended; nobody is left to read.
            self._closing = True
