"""A UDP port that listens."""

from __future__ import annotations

import asyncio
import contextlib
import errno

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.transports.link import Received
from biosensor_gateway.transports.threads import in_daemon_thread
from biosensor_gateway.transports.traffic import Traffic
from biosensor_gateway.transports.udp_port import UdpPort


class UdpLink:
    """Datagrams that come to a port of this computer, each of them whole."""

    in_messages = True

    def __init__(self, port: int) -> None:
        self._port = port
        self._udp: UdpPort | None = None
        self._traffic = Traffic(f"UDP port {port}", "is the network still there?")

    async def open(self) -> None:
        """Listen.

        Raises
        ------
        TransportError
            ``BUSY``, ``DENIED`` or ``UNAVAILABLE``.
        """
        try:
            udp = self._udp = UdpPort(port=self._port)
        except OSError as error:
            raise self._refusal(error) from error
        self._traffic.start(lambda: self._read_forever(udp), lambda: None)

    async def read(self) -> Received:
        """Wait for the next datagram; raise ``LOST`` when the port is gone."""
        return await self._traffic.read()

    async def send(self, text: str) -> None:
        """Do nothing: whom to send to is not known."""

    async def close(self) -> None:
        """Stop listening."""
        self._traffic.closing = True
        if self._udp is not None:
            self._udp.end()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(1.0):
                    await in_daemon_thread(self._traffic.join_reader)

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

    def _read_forever(self, udp: UdpPort) -> None:
        try:
            udp.read_forever(lambda data, arrival, _: self._traffic.deliver(data, arrival))
        except OSError as error:
            self._traffic.lost(error)
