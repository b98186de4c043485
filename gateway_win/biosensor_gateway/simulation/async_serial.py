"""The serial port of a virtual device: a pseudo-terminal, or TCP if not available.

Neither reports that a host opened the port, just as a Bluetooth module does not report it to its
firmware, so a device only sends after the first command. A host that closes the port ends the
radio link, which is reported.
"""

from __future__ import annotations

import asyncio
import os
import select
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.simulation.faults import Glue
from biosensor_gateway.simulation.tcp_port import LOOPBACK, TcpPort

# Time that the system may need to report written data as unread.
_CHECK_S = 0.02
_PATIENCE_S = 1.0


if sys.platform != "win32":  # termios exists only there
    import fcntl
    import struct
    import termios
    import tty

_HOST_CHECK_S = 0.02
_READ_SIZE = 4096


class PtyPort:
    """A pseudo-terminal under one stable path.

    Every `open` creates a new terminal; the path is a symbolic link to it and does not exist while
    the port is closed.

    Parameters
    ----------
    heard, left
        Called with the host's bytes, and when a host closes the port; not after `hang_up`.
    buffer_bytes
        Buffer for a host that does not read, in addition to the operating system's 16-20 KiB. A
        radio's buffer is small; a test that must not lose data at high speed needs a large one.
    """

    def __init__(
        self, heard: Callable[[bytes], None], left: Callable[[], None], buffer_bytes: int
    ) -> None:
        self._heard = heard
        self._left = left
        self._buffer_bytes = buffer_bytes
        self._unsent = bytearray()
        self._glue = Glue(self._send)
        self._loop = asyncio.get_running_loop()
        self._folder = Path(tempfile.mkdtemp(prefix="virtual-serial-"))
        self._handle: int | None = None
        self._host_check: asyncio.TimerHandle | None = None
        self._hosted = False

    @property
    def name(self) -> str:
        """Path of the port."""
        return str(self._path)

    def open(self) -> None:
        """Create a terminal, and let the path point to it.

        Raises
        ------
        TransportError
            UNAVAILABLE if this system has no pseudo-terminals, or none left.
        """
        if sys.platform == "win32":
            raise TransportError(
                TransportReason.UNAVAILABLE, "Windows has no pseudo-terminals to simulate a port."
            )
        if self._handle is not None:
            return
        try:
            self._handle, host_end = os.openpty()
        except OSError as error:
            message = (
                "this system has no pseudo-terminal left for a virtual serial port: "
                f"{error.strerror}; in a container, /dev/pts must be mounted"
            )
            raise TransportError(TransportReason.UNAVAILABLE, message) from error
        tty.setraw(self._handle)
        os.set_blocking(self._handle, False)
        self._path.symlink_to(os.ttyname(host_end))
        # If we kept it open, a host's closing could not be detected.
        os.close(host_end)
        self._await_host(self._handle)

    def write(self, data: bytes) -> bool:
        """Accept all of ``data`` or nothing."""
        return self._glue.write(data)

    def glue(self, *, on: bool) -> None:
        """Join data and split it at random places, or send it unchanged."""
        self._glue.switch(on=on)

    def _send(self, data: bytes) -> bool:
        if self._handle is None or not self._hosted:
            return False
        self._flush(self._handle)
        if self._unsent and len(self._unsent) + len(data) > self._buffer_bytes:
            return False
        self._unsent += data
        self._flush(self._handle)
        if self._unsent:
            self._loop.add_writer(self._handle, self._flush, self._handle)
        return True

    def drained(self) -> bool:
        """Whether the host has read everything."""
        if sys.platform == "win32" or not self._hosted:
            return True
        # The number of unread bytes is only available at the reading end.
        host_end = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        unread = struct.unpack("i", fcntl.ioctl(host_end, termios.FIONREAD, bytes(4)))[0]
        os.close(host_end)
        return not self._unsent and unread == 0

    def hang_up(self) -> None:
        """Close the terminal and remove its path; unread data are lost."""
        self._glue.flush()
        self._stop_watching()
        self._path.unlink(missing_ok=True)
        if self._handle is not None:
            os.close(self._handle)
        self._handle = None
        self._unsent.clear()

    def dispose(self) -> None:
        """Close the port and remove the path's folder."""
        self.hang_up()
        shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def _path(self) -> Path:
        return self._folder / "port"

    def _await_host(self, handle: int) -> None:
        """Poll whether a host has opened the port, because there is no event for it."""
        if _host_is_gone(handle):
            self._host_check = self._loop.call_later(_HOST_CHECK_S, self._await_host, handle)
            return
        self._hosted = True
        self._loop.add_reader(handle, self._read, handle)

    def _read(self, handle: int) -> None:
        try:
            data = os.read(handle, _READ_SIZE)
        except BlockingIOError:
            return
        except OSError:  # raised when the terminal's other end was closed
            self._stop_watching()
            self._forget(handle)
            self._await_host(handle)
            self._left()
            return
        if data:
            self._heard(data)

    def _forget(self, handle: int) -> None:
        """Discard buffered and unread data."""
        self._glue.forget()
        self._unsent.clear()
        if sys.platform != "win32":
            # Everything the host wrote was read, so what is left now is from another host.
            termios.tcflush(handle, termios.TCOFLUSH)

    def _flush(self, handle: int) -> None:
        """Send as much of the buffered data as possible."""
        try:
            while self._unsent:
                del self._unsent[: os.write(handle, self._unsent)]
        except BlockingIOError:
            return
        self._loop.remove_writer(handle)

    def _stop_watching(self) -> None:
        self._hosted = False
        if self._host_check is not None:
            self._host_check.cancel()
        if self._handle is not None:
            self._loop.remove_reader(self._handle)
            self._loop.remove_writer(self._handle)


def _host_is_gone(handle: int) -> bool:
    if sys.platform == "win32":  # pragma: no cover - no port gets this far there
        return True
    poll = select.poll()
    poll.register(handle, select.POLLIN)
    # Data of a host that has already closed the port must still be read.
    return any(event & select.POLLHUP and not event & select.POLLIN for _, event in poll.poll(0))


# The smallest size that systems allow, similar to that of a pseudo-terminal.
_SEND_BUFFER_BYTES = 4096


class AsyncSerialPort(Protocol):
    """The device's end of a serial port; all methods must run in the loop's thread."""

    @property
    def name(self) -> str:
        """The port's name for the host, which stays the same when reopened."""
        ...

    def open(self) -> None:
        """Open the port."""
        ...

    def write(self, data: bytes) -> bool:
        """Accept all of ``data`` without blocking; return False without a host or room."""
        ...

    def glue(self, *, on: bool) -> None:
        """Join data and split it at random places from now on, or send it unchanged."""
        ...

    def drained(self) -> bool:
        """Whether a host has read everything, as far as known."""
        ...

    def hang_up(self) -> None:
        """Close the link until `open` is called; unread data are lost."""
        ...

    def dispose(self) -> None:
        """Close and remove the port permanently."""
        ...


def serial_port(
    heard: Callable[[bytes], None],
    left: Callable[[], None],
    *,
    buffer_bytes: int,
    tcp: bool = sys.platform == "win32",
) -> AsyncSerialPort:
    """Create the port of a virtual device; call this in the device's event loop.

    Parameters
    ----------
    heard, left
        Called with the host's bytes, and when a host closes the port; not after
        `AsyncSerialPort.hang_up`.
    buffer_bytes
        Buffer for a host that does not read, in addition to the operating system's.
    tcp
        Use a TCP server instead of a pseudo-terminal, which pyserial opens as
        ``socket://127.0.0.1:PORT``; default on systems without pseudo-terminals.

    Raises
    ------
    TransportError
        BUSY if no port of the loopback interface is available.
    """
    return TcpSerialPort(heard, left, buffer_bytes) if tcp else PtyPort(heard, left, buffer_bytes)


class TcpSerialPort:
    """A TCP server on the loopback interface instead of a serial port, for one host at a time.

    Parameters
    ----------
    heard, left
        Called with the host's bytes, and when a host closes the port; not after `hang_up`.
    buffer_bytes
        Buffer for a host that does not read, in addition to the system's buffers, whose sizes
        differ.

    Raises
    ------
    TransportError
        BUSY if no port of the loopback interface is available.
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
        """URL of the port for `serial.serial_for_url`."""
        return f"socket://{LOOPBACK}:{self._port.number}"

    def open(self) -> None:
        """Start accepting a host."""
        self._port.open()

    def write(self, data: bytes) -> bool:
        """Accept all of ``data`` or nothing."""
        return self._glue.write(data)

    def glue(self, *, on: bool) -> None:
        """Join data and split it at random places, or send it unchanged."""
        self._glue.switch(on=on)

    def drained(self) -> bool:
        """Whether everything was passed to the system."""
        return self._host is None or self._host.drained()

    def hang_up(self) -> None:
        """Close the connection and refuse others; the port number stays reserved."""
        self._glue.flush()
        self._port.shut()
        self._abort_host()

    def dispose(self) -> None:
        """Close the port and release its number."""
        self._glue.forget()
        self._port.close()
        self._abort_host()

    def received(self, host: _Host, data: bytes) -> None:
        """Pass on the current host's bytes."""
        if host is self._host:
            self._heard(data)

    def disconnected(self, host: _Host) -> None:
        """Process a host's disconnection."""
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
        """Accept the connection, unless it was aborted meanwhile."""
        if isinstance(transport, asyncio.Transport):
            self._transport = transport
            if self._aborted:
                transport.abort()

    def data_received(self, data: bytes) -> None:
        """Pass on the host's data."""
        self._port.received(self, data)

    def connection_lost(self, exc: Exception | None) -> None:
        """Process the end of the connection."""
        del exc
        self._port.disconnected(self)

    def write(self, data: bytes) -> bool:
        """Accept all of ``data`` or nothing."""
        if self._transport is None or self._transport.is_closing():
            return False
        waiting = self._transport.get_write_buffer_size()
        if waiting and waiting + len(data) > self._buffer_bytes:
            return False
        self._transport.write(data)
        return True

    def drained(self) -> bool:
        """Whether no data wait for room in the system's buffers."""
        return self._transport is None or not self._transport.get_write_buffer_size()

    def abort(self) -> None:
        """End the connection at once, or as soon as it is established."""
        self._aborted = True
        if self._transport is not None:
            self._transport.abort()


class PatientPort:
    """The device's end of a serial port that lets its host read what waits, then breaks the link.

    Data that a host has not read are lost when a port closes. With a busy host this is an unknown
    amount, which could not be distinguished from a device that stopped measuring. An
    `AsyncSerialPort` for the loop's thread.

    Parameters
    ----------
    heard, left, buffer_bytes, tcp
        As for `serial_port`.
    """

    def __init__(
        self,
        heard: Callable[[bytes], None],
        left: Callable[[], None],
        *,
        buffer_bytes: int,
        tcp: bool = sys.platform == "win32",
    ) -> None:
        self._heard, self._left = heard, left
        self._port = serial_port(self._hear, self._leave, buffer_bytes=buffer_bytes, tcp=tcp)
        self._loop = asyncio.get_running_loop()
        self._hanging_up: asyncio.TimerHandle | None = None
        self._written_s = self._deadline_s = 0.0
        self._opens_again = False

    @property
    def name(self) -> str:
        """The port's name for the host, which stays the same when reopened."""
        return self._port.name

    def open(self) -> None:
        """Open the port, at once or as soon as it has closed."""
        if self._hanging_up is None:
            self._port.open()
        else:
            self._opens_again = True

    def write(self, data: bytes) -> bool:
        """Accept all of ``data`` without blocking; return False without a host or room."""
        taken = self._hanging_up is None and self._port.write(data)
        if taken:
            self._written_s = self._loop.time()
        return taken

    def glue(self, *, on: bool) -> None:
        """Join data and split it at random places, or send it unchanged."""
        self._port.glue(on=on)

    def drained(self) -> bool:
        """Whether a host has read everything, as far as known."""
        return self._port.drained()

    def hang_up(self) -> None:
        """Stop sending and receiving, and close once the host has read everything.

        A host that does not read for a second loses the rest.
        """
        self._opens_again = False
        if self._hanging_up is None:
            self._deadline_s = self._loop.time() + _PATIENCE_S
            self._hang_up_if_read()

    def dispose(self) -> None:
        """Close and remove the port at once and permanently."""
        if self._hanging_up is not None:
            self._hanging_up.cancel()
        self._port.dispose()

    def _hang_up_if_read(self) -> None:
        now_s = self._loop.time()
        is_read = now_s >= self._written_s + _CHECK_S and self._port.drained()
        if not is_read and now_s < self._deadline_s:
            self._hanging_up = self._loop.call_later(_CHECK_S, self._hang_up_if_read)
            return
        self._hanging_up = None
        self._port.hang_up()
        if self._opens_again:
            self._port.open()

    def _hear(self, data: bytes) -> None:
        if self._hanging_up is None:
            self._heard(data)

    def _leave(self) -> None:
        if self._hanging_up is None:
            self._left()
