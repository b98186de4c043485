"""A UDP port of this computer, read by a thread that does nothing else.

An event loop takes one datagram a turn, and each turn may take long on a busy computer: what
waits would be stamped later and later, until a device's clock seems to have jumped.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable

from pylsl import local_clock

from biosensor_gateway.transports.receiving import Address, Receiver

_LOOK_S = 0.2
"""Within this time the reading ends."""
_BUFFER_BYTES = 1 << 20
"""What the system keeps for an agent that does not run."""


class UdpPort:
    """A port that is bound as soon as it is made.

    Parameters
    ----------
    host
        Address of this computer that it is reached by; empty for all.
    port
        0 takes a free one.

    Raises
    ------
    OSError
        The port cannot be had.
    """

    def __init__(self, host: str = "", port: int = 0) -> None:
        self._closing = False
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.settimeout(_LOOK_S)
            with contextlib.suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
            self._socket.bind((host, port))
        except OSError:
            self._socket.close()
            raise

    @property
    def number(self) -> int:
        """Number of the port."""
        number: int = self._socket.getsockname()[1]
        return number

    def send(self, data: bytes, to: Address) -> None:
        """Send a datagram; where nobody listens, nothing happens."""
        with contextlib.suppress(OSError):
            self._socket.sendto(data, to)

    def read_forever(self, take: Callable[[bytes, float, Address], object]) -> None:
        """Hand on all datagrams until `end`, then close; for a thread of its own.

        Parameters
        ----------
        take
            Gets the bytes, the LSL time of their arrival, and where they came from.

        Raises
        ------
        OSError
            The port is gone.
        """
        receiver = Receiver(self._socket)
        with self._socket:
            while not self._closing:
                try:
                    data, sender = receiver.read_from()
                except (TimeoutError, ConnectionResetError):
                    # Windows tells so that something which was sent elsewhere did not arrive.
                    continue
                if not self._closing:
                    take(data, local_clock(), sender)

    def end(self) -> None:
        """Let the reading end, and the port with it."""
        self._closing = True
