"""A UDP port of this computer, read by a thread that does nothing else.

An event loop takes one datagram a turn, and each turn may take long on a busy computer: what
waits would be stamped later and later, until a device's clock seems to have jumped.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
from collections.abc import Callable
from functools import partial

from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports.link import Address, Receiver
from biosensor_gateway.transports.threads import in_daemon_thread

Take = Callable[[bytes, float, Address], object]
_LOOK_S = 0.2
"""Within this time the reading ends."""
_END_LIMIT_S = 1.0
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
        self._reading: threading.Thread | None = None
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

    def listen(self, take: Take, lost: Callable[[OSError], object]) -> None:
        """Hand on all datagrams in the running event loop until `end`; a thread reads them.

        Parameters
        ----------
        take
            Gets the bytes, the LSL time of their arrival, and where they came from.
        lost
            Gets the error when the port is gone.
        """
        loop = asyncio.get_running_loop()

        def read() -> None:
            # A loop that has ended takes nothing.
            with contextlib.suppress(RuntimeError):
                try:
                    self._read_forever(partial(loop.call_soon_threadsafe, take))
                except OSError as error:
                    loop.call_soon_threadsafe(lost, error)

        self._reading = threading.Thread(target=read, daemon=True)
        self._reading.start()

    def _read_forever(self, take: Take) -> None:
        receiver = Receiver(self._socket)
        with self._socket:
            while not self._closing:
                try:
                    data, sender = receiver.read_from()
                except (TimeoutError, ConnectionResetError):
                    # Windows tells so that something which was sent elsewhere did not arrive.
                    continue
                if not self._closing:
                    take(data, LSL_CLOCK(), sender)

    def end(self) -> None:
        """Let the reading end, and the port with it."""
        self._closing = True
        if self._reading is None:
            self._socket.close()

    async def close(self) -> None:
        """End the reading, and wait until the port is free, at most for a second."""
        self.end()
        if self._reading is not None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_END_LIMIT_S):
                    await in_daemon_thread(self._reading.join)
