"""The ways by which lines come: bytes in a stream, or messages that end with a line."""

from __future__ import annotations

from typing import Protocol

from biosensor_gateway.devices.line_sensor.driver.settings import LineSettings
from biosensor_gateway.devices.line_sensor.driver.udp_link import UdpLink
from biosensor_gateway.transports.byte_links import byte_link
from biosensor_gateway.transports.link import ByteLink, Received
from biosensor_gateway.transports.websocket import WebSocketLink


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
        return UdpLink(settings.udp_port)
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
