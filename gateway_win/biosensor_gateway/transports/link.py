"""The interfaces of links of bytes and of texts, and how a socket is read."""

from __future__ import annotations

import socket
from typing import NamedTuple, Protocol

_LARGEST = 65536
"""Bytes of one read; no datagram is larger."""

Address = tuple[str, int]


class Receiver:
    """Reads from one socket, always into the same place.

    ``socket.recv`` makes room for the largest read each time and cuts it to the few bytes that
    came; what is left between the pieces lets a process grow by megabytes an hour.
    """

    def __init__(self, source: socket.socket) -> None:
        self._socket = source
        self._room = memoryview(bytearray(_LARGEST))

    def read(self) -> bytes:
        """Wait for the next bytes, as ``socket.recv`` does; raise what it raises."""
        return bytes(self._room[: self._socket.recv_into(self._room)])

    def read_from(self) -> tuple[bytes, Address]:
        """Wait for the next datagram, and say who sent it, as ``socket.recvfrom`` does."""
        size, address = self._socket.recvfrom_into(self._room)
        return bytes(self._room[:size]), (address[0], address[1])


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
