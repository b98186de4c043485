"""The ways by which lines come: bytes in a stream, or messages that end with a line."""

from __future__ import annotations

import asyncio
import errno
from typing import Protocol

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.devices.line_sensor.driver.settings import LineSettings
from biosensor_gateway.transports.byte_links import byte_link
from biosensor_gateway.transports.link import ByteLink, Received
from biosensor_gateway.transports.receiving import Address
from biosensor_gateway.transports.udp_port import UdpPort
from biosensor_gateway.transports.websocket import WebSocketLink


class _UdpLink:
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


class LineLink(Protocol):
    """Where lines come from.

    Attributes
    ----------
    in_messages
        Whether each read ends with a line.
    """

    in_messages: bool

    async def open(self) -> None:
        """Open it; raises TransportError, and ConfigError for what is no address."""
        ...

    async def read(self) -> Received:
        """Wait for the next bytes; raise TransportError ``LOST`` at its end."""
        ...

    async def send(self, text: str) -> None:
        """Send a command."""
        ...

    async def close(self) -> None:
        """Close it; never raises."""
        ...


def line_link(settings: LineSettings) -> LineLink:
    """Return the closed link that the settings ask for."""
    if settings.udp_port is not None:
        return _UdpLink(settings.udp_port)
    if settings.url is not None:
        return _WebSocket(settings.url)
    assert settings.port is not None
    return _ByteStream(byte_link(settings.port, settings.baud_rate))


class _ByteStream:
    """A serial port or a TCP connection."""

    in_messages = False

    def __init__(self, link: ByteLink) -> None:
        self._link = link
        self.open = link.open
        self.read = link.read
        self.close = link.close

    async def send(self, text: str) -> None:
        self._link.write(text.encode())


class _WebSocket:
    """Messages of text over a WebSocket."""

    in_messages = True

    def __init__(self, url: str) -> None:
        self._link = WebSocketLink(url)
        self.open = self._link.open
        self.send = self._link.send
        self.close = self._link.close

    async def read(self) -> Received:
        text, arrival_s = await self._link.read()
        return Received(text.encode("utf-8", "surrogatepass"), arrival_s)
