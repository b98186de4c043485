"""A pseudo-terminal that can hang up, as the serial port of a virtual device."""

from __future__ import annotations

import asyncio
import os
import select
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.simulation.glue import Glue

if sys.platform != "win32":  # termios exists only there
    import fcntl
    import struct
    import termios
    import tty

_HOST_CHECK_S = 0.02
_READ_SIZE = 4096


class PtyPort:
    """A pseudo-terminal under one stable path.

    Every `open` makes a new terminal; the path is a symbolic link to it and does not
    exist while the port is down.

    Parameters
    ----------
    heard, left
        Called with the host's bytes, and when a host closed the port; not after
        `hang_up`.
    buffer_bytes
        What is kept for a host that does not read, beyond the 16-20 KiB that the
        operating system keeps. A radio's buffer is small; a test that must not lose a
        byte at high speed takes a large one.
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
        """Make a terminal and point the path at it.

        Raises
        ------
        TransportError
            UNAVAILABLE if this system has no pseudo-terminals.
        """
        if sys.platform == "win32":
            raise TransportError(
                TransportReason.UNAVAILABLE, "Windows has no pseudo-terminals to simulate a port."
            )
        if self._handle is not None:
            return
        self._handle, host_end = os.openpty()
        tty.setraw(self._handle)
        os.set_blocking(self._handle, False)
        self._path.symlink_to(os.ttyname(host_end))
        # Held open by us, it would not show that a host closes it.
        os.close(host_end)
        self._await_host(self._handle)

    def write(self, data: bytes) -> bool:
        """Take all of ``data`` or nothing."""
        return self._glue.write(data)

    def glue(self, *, on: bool) -> None:
        """Have what is written go together and cut anywhere, or as it is."""
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
        """Tell whether the host has read all that was written."""
        if sys.platform == "win32" or not self._hosted:
            return True
        # What waits to be read can be asked at the end where it is read.
        host_end = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        unread = struct.unpack("i", fcntl.ioctl(host_end, termios.FIONREAD, bytes(4)))[0]
        os.close(host_end)
        return not self._unsent and unread == 0

    def hang_up(self) -> None:
        """Close the terminal and remove its path; what the host has not read is lost."""
        self._glue.flush()
        self._stop_watching()
        self._path.unlink(missing_ok=True)
        if self._handle is not None:
            os.close(self._handle)
        self._handle = None
        self._unsent.clear()

    def dispose(self) -> None:
        """Hang up and remove the path's folder."""
        self.hang_up()
        shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def _path(self) -> Path:
        return self._folder / "port"

    def _await_host(self, handle: int) -> None:
        """Look whether a host has the port open: of that there is no event."""
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
        except OSError:  # how a terminal says that its other end was closed
            self._stop_watching()
            self._forget(handle)
            self._await_host(handle)
            self._left()
            return
        if data:
            self._heard(data)

    def _forget(self, handle: int) -> None:
        """Throw away what is buffered and what no host has read."""
        self._glue.forget()
        self._unsent.clear()
        if sys.platform != "win32":
            # All that the host has written was heard; what there is now is another one's.
            termios.tcflush(handle, termios.TCOFLUSH)

    def _flush(self, handle: int) -> None:
        """Send of what is buffered as much as there is room for."""
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
    # Bytes of a host that has already left are still to be heard.
    return any(event & select.POLLHUP and not event & select.POLLIN for _, event in poll.poll(0))
