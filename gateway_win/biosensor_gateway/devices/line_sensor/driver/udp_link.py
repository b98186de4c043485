"""A UDP port that listens."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket

from pylsl import local_clock

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.transports.link import Received
from biosensor_gateway.transports.receiving import Receiver
from biosensor_gateway.transports.threads import in_daemon_thread
from biosensor_gateway.transports.traffic import Traffic

_LOOK_S = 0.2
_BUFFER_BYTES = 1 << 20
"""What the system keeps for an agent that does not run."""


class UdpLink:
    """Datagrams that come to a port of this computer, each of them whole."""

    in_messages = True

    def __init__(self, port: int) -> None:
        self._port = port
        self._socket: socket.socket | None = None
        self._traffic = Traffic(f"UDP port {port}", "is the network still there?")

    async def open(self) -> None:
        """Listen.

        Raises
        ------
        TransportError
            ``BUSY``, ``DENIED`` or ``UNAVAILABLE``.
        """
        listening = self._bound()
        self._socket = listening
        self._traffic.start(lambda: self._read_forever(listening), lambda: None)

    async def read(self) -> Received:
        """Wait for the next datagram; raise ``LOST`` when the port is gone."""
        return await self._traffic.read()

    async def send(self, text: str) -> None:
        """Do nothing: whom to send to is not known."""

    async def close(self) -> None:
        """Stop listening."""
        self._traffic.closing = True
        if self._socket is not None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(1.0):
                    await in_daemon_thread(self._traffic.join_reader)
            self._socket.close()

    def _bound(self) -> socket.socket:
        listening = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            listening.settimeout(_LOOK_S)
            with contextlib.suppress(OSError):
                listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
            listening.bind(("", self._port))
        except OSError as error:
            listening.close()
            raise self._refusal(error) from error
        return listening

    def _refusal(self, error: OSError) -> TransportError:
        name = f"UDP port {self._port}"
        if error.errno == errno.EADDRINUSE:
            advice = "another program, or another device, has it; choose another number for both"
            return TransportError(TransportReason.BUSY, f"{name}: {advice}")
        if error.errno in (errno.EACCES, errno.EPERM):
            advice = "the system keeps it; choose a number above 1023"
            return TransportError(TransportReason.DENIED, f"{name}: {advice}")
        message = f"{name}: it cannot be had ({error.strerror or error})"
        return TransportError(TransportReason.UNAVAILABLE, message)

    def _read_forever(self, listening: socket.socket) -> None:
        receiver = Receiver(listening)
        while not self._traffic.closing:
            try:
                data = receiver.read()
            except (TimeoutError, ConnectionResetError):
                # Windows tells so that something which was sent elsewhere did not arrive.
                continue
            except OSError as error:
                self._traffic.lost(error)
                return
            if not self._traffic.closing:
                self._traffic.deliver(data, local_clock())
