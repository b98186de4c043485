"""The serial port of a virtual device: a pseudo-terminal, or TCP where there are none.

Neither tells that a host opened the port, as a Bluetooth module does not tell it to its
firmware: a device speaks after the first command. That a host left ends the radio link and
is told.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Protocol

from biosensor_gateway.simulation.pty_port import PtyPort
from biosensor_gateway.simulation.tcp_serial import TcpSerialPort


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
