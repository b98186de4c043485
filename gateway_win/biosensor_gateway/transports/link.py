"""The interfaces of links of bytes and of texts."""

from __future__ import annotations

from typing import NamedTuple, Protocol


class Received(NamedTuple):
    """Bytes and the LSL time at which they arrived."""

    data: bytes
    arrival: float


class ByteLink(Protocol):
    """Bytes in and out, nothing about their meaning."""

    async def open(self) -> None:
        """Open the link.

        Raises
        ------
        TransportError
            ``ABSENT``, ``BUSY``, ``DENIED`` or ``UNAVAILABLE``.
        """
        ...

    async def read(self) -> Received:
        """Wait for the next bytes.

        Raises
        ------
        TransportError
            ``LOST``, once everything that had arrived was read.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send without waiting; a failure shows in ``read``."""
        ...

    async def close(self) -> None:
        """Send what is waiting, for a moment, and close; never raises."""
        ...


class ReceivedText(NamedTuple):
    """A message and the LSL time at which it arrived."""

    text: str
    arrival: float


class TextLink(Protocol):
    """Texts in and out, whole ones."""

    @property
    def dropped(self) -> int:
        """Messages that came and could not be kept."""
        ...

    async def open(self) -> None:
        """Connect.

        Raises
        ------
        TransportError, ConfigError
            What listens there is absent, refuses, or is something else; the address is none.
        """
        ...

    async def read(self) -> ReceivedText:
        """Wait for the next message.

        Raises
        ------
        TransportError
            ``LOST``, once everything that had arrived was read.
        """
        ...

    async def send(self, text: str) -> None:
        """Send a message; raise TransportError ``LOST`` if the connection has ended."""
        ...

    async def close(self) -> None:
        """Close; never raises."""
        ...
