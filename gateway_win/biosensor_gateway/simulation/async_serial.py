"""The serial port of a virtual device: a pseudo-terminal, or TCP where there are none.

Neither tells that a host opened the port, as a Bluetooth module does not tell it to its
firmware: a device speaks after the first command. That a host left ends the radio link and
is told.
"""

from __future__ import annotations

import asyncio
import socket
import sys
from collections.abc import Callable
from typing import Protocol

from biosensor_gateway.simulation.glue import Glue
from biosensor_gateway.simulation.pty_port import PtyPort
from biosensor_gateway.simulation.tcp_port import LOOPBACK, TcpPort

# The smallest that systems allow, near what a pseudo-terminal keeps.
_SEND_BUFFER_BYTES = 4096


class AsyncSerialPort(Protocol):
    """The device's end of a serial port; every method is for the loop's thread."""

    @property
    def name(self) -> str:
        """What a host opens; the same over hang-ups."""
        ...

    def open(self) -> None:
        """Become reachable."""
        ...

    def write(self, data: bytes) -> bool:
        """Take the whole of ``data`` without blocking; False without host or room."""
        ...

    def glue(self, *, on: bool) -> None:
        """Have what is written go together and cut anywhere, from now on, or as it is."""
        ...

    def drained(self) -> bool:
        """Tell whether nothing is left that a host could still read, as far as is known."""
        ...

    def hang_up(self) -> None:
        """Cut the link and be unreachable until `open`; unread bytes are lost."""
        ...

    def dispose(self) -> None:
        """Hang up and remove what is left of the port; it cannot be opened again."""
        ...


def serial_port(
    heard: Callable[[bytes], None],
    left: Callable[[], None],
    *,
    buffer_bytes: int,
    tcp: bool = sys.platform == "win32",
) -> AsyncSerialPort:
    """Make the port of a virtual device; call it in the device's loop.

    Parameters
    ----------
    heard, left
        Called with the host's bytes, and when a host closed the port; not after
        `AsyncSerialPort.hang_up`.
    buffer_bytes
        What is kept for a host that does not read, beyond what the operating system keeps.
    tcp
        A TCP server instead of a pseudo-terminal, which pyserial opens as
        ``socket://127.0.0.1:PORT``; by default where there is none.

    Raises
    ------
    TransportError
        BUSY if no port of loopback can be had.
    """
    return TcpSerialPort(heard, left, buffer_bytes) if tcp else PtyPort(heard, left, buffer_bytes)


class TcpSerialPort:
    """A TCP server on loopback in the place of a serial port; one host at a time.

    Parameters
    ----------
    heard, left
        Called with the host's bytes, and when a host closed the port; not after
        `hang_up`.
    buffer_bytes
        What is kept for a host that does not read, beyond what the system's buffers
        hold, which are larger on some.

    Raises
    ------
    TransportError
        BUSY if no port of loopback can be had.
    """

    def __init__(
        self, heard: Callable[[bytes], None], left: Callable[[], None], buffer_bytes: int
    ) -> None:
        self._heard = heard
        self._left = left
        self._buffer_bytes = buffer_bytes
        self._host: _Host | None = None
        self._glue = Glue(self._send)
        self._port = TcpPort(self._connected, _SEND_BUFFER_BYTES)
        self._port.bind()

    @property
    def name(self) -> str:
        """URL of the port, as `serial.serial_for_url` takes it."""
        return f"socket://{LOOPBACK}:{self._port.number}"

    def open(self) -> None:
        """Accept a host."""
        self._port.open()

    def write(self, data: bytes) -> bool:
        """Take all of ``data`` or nothing."""
        return self._glue.write(data)

    def glue(self, *, on: bool) -> None:
        """Have what is written go together and cut anywhere, or as it is."""
        self._glue.switch(on=on)

    def drained(self) -> bool:
        """Tell whether everything was handed to the system."""
        return self._host is None or self._host.drained()

    def hang_up(self) -> None:
        """Close the connection and refuse others; the port's number stays taken."""
        self._glue.flush()
        self._port.shut()
        self._abort_host()

    def dispose(self) -> None:
        """Hang up and give the port's number back."""
        self._glue.forget()
        self._port.close()
        self._abort_host()

    def received(self, host: _Host, data: bytes) -> None:
        """Pass on the present host's bytes."""
        if host is self._host:
            self._heard(data)

    def disconnected(self, host: _Host) -> None:
        """Note that a host went away by itself."""
        if host is self._host:
            self._host = None
            self._glue.forget()
            self._left()

    def _send(self, data: bytes) -> bool:
        return self._host is not None and self._host.write(data)

    def _connected(self, connection: socket.socket) -> None:
        if self._host is None:
            self._host = _Host(self, connection, self._buffer_bytes)
        else:
            connection.close()

    def _abort_host(self) -> None:
        if self._host is not None:
            host, self._host = self._host, None
            host.abort()


class _Host(asyncio.Protocol):
    """One connection to a `TcpSerialPort`."""

    def __init__(self, port: TcpSerialPort, connection: socket.socket, buffer_bytes: int) -> None:
        self._port = port
        self._buffer_bytes = buffer_bytes
        self._transport: asyncio.Transport | None = None
        self._aborted = False
        loop = asyncio.get_running_loop()
        self._connecting = loop.create_task(loop.connect_accepted_socket(lambda: self, connection))

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the connection, if it is still wanted."""
        if isinstance(transport, asyncio.Transport):
            self._transport = transport
            if self._aborted:
                transport.abort()

    def data_received(self, data: bytes) -> None:
        """Pass on what the host says."""
        self._port.received(self, data)

    def connection_lost(self, exc: Exception | None) -> None:
        """Note that the host is gone."""
        del exc
        self._port.disconnected(self)

    def write(self, data: bytes) -> bool:
        """Take all of ``data`` or nothing."""
        if self._transport is None or self._transport.is_closing():
            return False
        waiting = self._transport.get_write_buffer_size()
        if waiting and waiting + len(data) > self._buffer_bytes:
            return False
        self._transport.write(data)
        return True

    def drained(self) -> bool:
        """Tell whether nothing waits for room in the system's buffers."""
        return self._transport is None or not self._transport.get_write_buffer_size()

    def abort(self) -> None:
        """End the connection at once, or as soon as it is made."""
        self._aborted = True
        if self._transport is not None:
            self._transport.abort()
