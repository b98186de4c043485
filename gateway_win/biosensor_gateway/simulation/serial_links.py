"""The byte link under a virtual serial device: a pseudo-terminal that can hang up.

`Link` is for a device with a thread of its own, `AsyncSerialPort` for one in a loop.
"""

from __future__ import annotations

import os
import select
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable
from math import inf
from pathlib import Path
from typing import Protocol

from biosensor_common.errors import TransportError, TransportReason

if sys.platform != "win32":  # termios exists only there
    import fcntl
    import struct
    import termios
    import tty

Heard = Callable[[bytes], None]
Left = Callable[[], None]

_READ_SIZE = 4096


class Link(Protocol):
    """Bytes to and from one host; all but `wake` are called by one thread."""

    @property
    def port(self) -> str:
        """What a host opens."""
        ...

    def open(self) -> None:
        """Become reachable."""
        ...

    def exchange(self, timeout_s: float) -> bytes:
        """Send what is buffered; return the host's bytes, b"" at the timeout or `wake`."""
        ...

    def write(self, data: bytes) -> bool:
        """Take the whole of ``data`` without blocking; False if there is no room."""
        ...

    def drained(self) -> bool:
        """Tell whether the host has read everything."""
        ...

    def close(self) -> None:
        """Hang up; a host that has the link open sees it."""
        ...

    def wake(self) -> None:
        """End a running `exchange` from any thread."""
        ...

    def dispose(self) -> None:
        """Close for good and remove what is left of the link."""
        ...


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

    def hang_up(self) -> None:
        """Cut the link and be unreachable until `open`; unread bytes are lost."""
        ...

    def dispose(self) -> None:
        """Hang up and remove what is left of the port; it cannot be opened again."""
        ...


class PtyLink:
    """A pseudo-terminal under one stable path.

    Every `open` makes a new terminal; the path is a symbolic link to it and
    does not exist while the link is down.

    Parameters
    ----------
    buffer_bytes
        How much is kept for a host that does not read, beyond the 16-20 KiB that
        the operating system keeps. A radio's buffer is small; a test that must not
        lose a byte at high speed takes a large one.
    """

    def __init__(self, buffer_bytes: int = 4096) -> None:
        self._buffer_bytes = buffer_bytes
        self._unsent = bytearray()
        self._master: int | None = None
        self._slave: int | None = None
        self._folder = Path(tempfile.mkdtemp(prefix="virtual-serial-"))
        self._woken, self._waker = socket.socketpair()
        self._woken.setblocking(False)

    @property
    def port(self) -> str:
        """Path that a host opens as a serial port."""
        return str(self._folder / "port")

    def open(self) -> None:
        """Make a new terminal and point the path at it.

        Raises
        ------
        TransportError
            UNAVAILABLE if this system has no pseudo-terminals.
        """
        if sys.platform == "win32":
            raise TransportError(
                TransportReason.UNAVAILABLE, "Windows has no pseudo-terminals to simulate a port."
            )
        # Our own slave handle keeps the master readable while no host has it open.
        self._master, self._slave = os.openpty()
        tty.setraw(self._master)
        os.set_blocking(self._master, False)
        Path(self.port).symlink_to(os.ttyname(self._slave))

    @property
    def handle(self) -> int | None:
        """The device's end of the terminal, for an event loop; None while it is down."""
        return self._master

    @property
    def unsent(self) -> int:
        """Bytes that wait for `flush`."""
        return len(self._unsent)

    def leave_host_end(self) -> None:
        """Let go of the host's end, so that a host's leaving shows as a hang-up."""
        if self._slave is not None:
            os.close(self._slave)
            self._slave = None

    def flush(self) -> None:
        """Send of what is buffered as much as there is room for."""
        if self._master is not None:
            self._flush(self._master)

    def forget(self) -> None:
        """Throw away what is buffered and what no host has read."""
        self._unsent.clear()
        if sys.platform != "win32" and self._master is not None:
            termios.tcflush(self._master, termios.TCIOFLUSH)

    def exchange(self, timeout_s: float) -> bytes:
        """Flush, then wait for the host's bytes, a `wake` or the timeout [s]."""
        master = [] if self._master is None else [self._master]
        readable, writable, _ = select.select(
            [self._woken, *master],
            master if self._unsent else [],
            [],
            None if timeout_s == inf else max(0.0, timeout_s),
        )
        if self._woken in readable:
            self._woken.recv(_READ_SIZE)
        if self._master is None:
            return b""
        if writable:
            self._flush(self._master)
        return os.read(self._master, _READ_SIZE) if self._master in readable else b""

    def write(self, data: bytes) -> bool:
        """Take all of ``data`` or, when down or out of room, nothing."""
        if self._master is None:
            return False
        self._flush(self._master)
        if self._unsent and len(self._unsent) + len(data) > self._buffer_bytes:
            return False
        self._unsent += data
        self._flush(self._master)
        return True

    def drained(self) -> bool:
        """Tell whether the host has read everything that was written."""
        if sys.platform == "win32" or self._slave is None:
            return True
        unread = struct.unpack("i", fcntl.ioctl(self._slave, termios.FIONREAD, bytes(4)))[0]
        return not self._unsent and unread == 0

    def close(self) -> None:
        """Hang up. Bytes that the host has not read yet are lost."""
        Path(self.port).unlink(missing_ok=True)
        for handle in (self._master, self._slave):
            if handle is not None:
                os.close(handle)
        self._master = self._slave = None
        self._unsent.clear()

    def wake(self) -> None:
        """End a running `exchange`; safe in any thread."""
        self._waker.send(b"w")

    def dispose(self) -> None:
        """Close and remove the path's folder; the link cannot be opened again, only disposed of."""
        self.close()
        self._woken.close()
        self._waker.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _flush(self, master: int) -> None:
        try:
            while self._unsent:
                del self._unsent[: os.write(master, self._unsent)]
        except BlockingIOError:
            return
