"""A UDP port that listens."""

from __future__ import annotations

import asyncio
import errno

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.transports.link import Received
from biosensor_gateway.transports.receiving import Address
from biosensor_gateway.transports.udp_port import UdpPort


class UdpLink:
    """Datagrams that come to a port of this computer, each of them whole."""

    in_messages = True

    def __init__(self, port: int) -> None:
        self._port = port
        self._udp: UdpPort | None = None
        self._incoming: asyncio.Queue[Received | TransportError] = asyncio.Queue()

    async def open(self) -> None:
        """Listen.

        Raises
        ------
        TransportError
            ``BUSY``, ``DENIED`` or ``UNAVAILABLE``.
        """
        try:
            self._udp = UdpPort(port=self._port)
        except OSError as error:
            raise self._refusal(error) from error
        self._udp.listen(self._take, self._lost)

    async def read(self) -> Received:
        """Wait for the next datagram; raise ``LOST`` when the port is gone."""
        item = await self._incoming.get()
        if isinstance(item, TransportError):
            self._incoming.put_nowait(item)
            raise item
        return item

    async def send(self, text: str) -> None:
        """Do nothing: whom to send to is not known."""

    async def close(self) -> None:
        """Stop listening."""
        if self._udp is not None:
            await self._udp.close()

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

    def _take(self, data: bytes, arrival_s: float, sender: Address) -> None:
        del sender
        self._incoming.put_nowait(Received(data, arrival_s))

    def _lost(self, cause: OSError) -> None:
        message = f"UDP port {self._port}: the link was cut; is the network still there?"
        error = TransportError(TransportReason.LOST, message)
        error.__cause__ = cause
        self._incoming.put_nowait(error)
