"""The serial port of a virtual device that lives in an asyncio loop.

A pseudo-terminal where the system has them, else, or on request, a TCP server on
loopback, which pyserial opens as ``socket://127.0.0.1:PORT``. Neither tells that a
host opened the port, as a Bluetooth module does not tell it to its firmware: a device
speaks after the first command. That a host left ends the radio link and is told.
"""

from __future__ import annotations

import asyncio
import select
import sys

from biosensor_gateway.simulation.serial_links import AsyncSerialPort, Heard, Left, PtyLink
from biosensor_gateway.simulation.tcp_serial import TcpPort

_HOST_CHECK_S = 0.02


class PtyPort:
    """A pseudo-terminal under one stable path.

    Parameters
    ----------
    heard, left
        Called with the host's bytes, and when a host closed the port; not after
        `hang_up`.
    buffer_bytes
        What is kept for a host that does not read, beyond the 16-20 KiB that the
        operating system keeps.
    """

    def __init__(self, heard: Heard, left: Left, buffer_bytes: int) -> None:
        self._heard = heard
        self._left = left
        self._link = PtyLink(buffer_bytes)
        self._loop = asyncio.get_running_loop()
        self._host_check: asyncio.TimerHandle | None = None
        self._hosted = False

    @property
    def name(self) -> str:
        """Path of the port."""
        return self._link.port

    def open(self) -> None:
        """Make a terminal; see `PtyLink.open` for the error."""
        if self._link.handle is None:
            self._link.open()
            self._link.leave_host_end()
            self._await_host()

    def write(self, data: bytes) -> bool:
        """Take all of ``data`` or nothing."""
        taken = self._hosted and self._link.write(data)
        if self._link.unsent and self._link.handle is not None:
            self._loop.add_writer(self._link.handle, self._flush)
        return taken

    def hang_up(self) -> None:
        """Close the terminal and remove its path."""
        self._stop_watching()
        self._link.close()

    def dispose(self) -> None:
        """Hang up and remove the path's folder."""
        self._stop_watching()
        self._link.dispose()

    def _await_host(self) -> None:
        """Look whether a host has the port open: of that there is no event."""
        handle = self._link.handle
        if handle is None:
            return
        if _host_is_gone(handle):
            self._host_check = self._loop.call_later(_HOST_CHECK_S, self._await_host)
            return
        self._hosted = True
        self._loop.add_reader(handle, self._read)

    def _read(self) -> None:
        try:
            data = self._link.exchange(0.0)
        except OSError:  # how a terminal says that its other end was closed
            self._stop_watching()
            self._link.forget()
            self._await_host()
            self._left()
            return
        if data:
            self._heard(data)

    def _flush(self) -> None:
        self._link.flush()
        if not self._link.unsent and self._link.handle is not None:
            self._loop.remove_writer(self._link.handle)

    def _stop_watching(self) -> None:
        self._hosted = False
        if self._host_check is not None:
            self._host_check.cancel()
        if self._link.handle is not None:
            self._loop.remove_reader(self._link.handle)
            self._loop.remove_writer(self._link.handle)


def _host_is_gone(handle: int) -> bool:
    if sys.platform == "win32":  # pragma: no cover - no port gets this far there
        return True
    poll = select.poll()
    poll.register(handle, select.POLLIN)
    # Bytes of a host that has already left are still to be heard.
    return any(event & select.POLLHUP and not event & select.POLLIN for _, event in poll.poll(0))


def serial_port(
    heard: Heard, left: Left, *, buffer_bytes: int, tcp: bool = sys.platform == "win32"
) -> AsyncSerialPort:
    """Make the port of a virtual device; call it in the device's loop.

    Parameters
    ----------
    heard, left, buffer_bytes
        See `PtyPort`.
    tcp
        A TCP server instead of a pseudo-terminal; by default where there is none.

    Raises
    ------
    TransportError
        BUSY if no port of loopback can be had.
    """
    return TcpPort(heard, left, buffer_bytes) if tcp else PtyPort(heard, left, buffer_bytes)
