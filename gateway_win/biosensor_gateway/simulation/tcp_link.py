"""A TCP server on loopback as the link of a device that has a thread of its own."""

from __future__ import annotations

import select
import socket
from math import inf

from biosensor_gateway.simulation.tcp_serial import LOOPBACK, bound_socket

_READ_SIZE = 4096


class TcpHostLink:
    """One host at a time; see :class:`~biosensor_gateway.simulation.serial_links.Link`.

    Parameters
    ----------
    buffer_bytes
        What is kept for a host that does not read, beyond the system's buffers.

    Raises
    ------
    TransportError
        ``BUSY`` if no port of loopback can be had.
    """

    def __init__(self, buffer_bytes: int = 4096) -> None:
        self._buffer_bytes = buffer_bytes
        self._unsent = bytearray()
        self._listener = bound_socket(0)
        self._number = int(self._listener.getsockname()[1])
        self._listening = False
        self._host: socket.socket | None = None
        self._woken, self._waker = socket.socketpair()
        self._woken.setblocking(False)

    @property
    def port(self) -> str:
        """URL that a host opens; the same over hang-ups."""
        return f"socket://{LOOPBACK}:{self._number}"

    def open(self) -> None:
        """Accept a host."""
        self._listener.listen()
        self._listening = True

    def exchange(self, timeout_s: float) -> bytes:
        """Flush, then wait for the host's bytes, a `wake` or the timeout [s]."""
        awaited = [self._woken, *([self._listener] if self._listening else [])]
        hosts = [] if self._host is None else [self._host]
        readable, writable, _ = select.select(
            [*awaited, *hosts],
            hosts if self._unsent else [],
            [],
            None if timeout_s == inf else max(0.0, timeout_s),
        )
        if self._woken in readable:
            self._woken.recv(_READ_SIZE)
        if self._listening and self._listener in readable:
            self._accept()
        if writable:
            self._flush()
        return self._receive() if self._host in readable else b""

    def write(self, data: bytes) -> bool:
        """Take all of ``data`` or, without a host or room, nothing."""
        if self._host is None:
            return False
        self._flush()
        if self._unsent and len(self._unsent) + len(data) > self._buffer_bytes:
            return False
        self._unsent += data
        self._flush()
        return True

    def drained(self) -> bool:
        """Tell whether everything was handed to the system."""
        return not self._unsent

    def close(self) -> None:
        """Hang up and refuse other hosts; the number stays taken."""
        self._drop_host()
        if self._listening:
            self._listener.close()
            self._listener = bound_socket(self._number)
            self._listening = False

    def wake(self) -> None:
        """End a running `exchange` from any thread."""
        self._waker.send(b"w")

    def dispose(self) -> None:
        """Close everything."""
        self._drop_host()
        for each in (self._listener, self._woken, self._waker):
            each.close()

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except BlockingIOError:
            # Whoever knocked has gone again.
            return
        if self._host is not None:
            connection.close()
            return
        connection.setblocking(False)
        self._host = connection

    def _receive(self) -> bytes:
        assert self._host is not None
        try:
            data = self._host.recv(_READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop_host()
        return data

    def _flush(self) -> None:
        if self._host is None or not self._unsent:
            return
        try:
            del self._unsent[: self._host.send(self._unsent)]
        except BlockingIOError:
            pass
        except OSError:
            self._drop_host()

    def _drop_host(self) -> None:
        self._unsent.clear()
        if self._host is not None:
            self._host.close()
            self._host = None
