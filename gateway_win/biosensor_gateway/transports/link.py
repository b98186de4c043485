"""The interfaces of links of bytes and of texts, how a socket is read, and what comes too early."""

from __future__ import annotations

import socket
from collections import deque
from typing import Generic, NamedTuple, Protocol, TypeVar

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


_T = TypeVar("_T")


class Early(Generic[_T]):
    """What came early, in order, until it is taken.

    A device talks while its driver still asks who it is, or before its clock is known; what it
    has measured by then is not to be lost.

    Parameters
    ----------
    most
        So many are kept.
    is_newest_kept
        Whether the oldest makes room where more come; else those are passed over, so that
        nothing is missing between what is kept.
    """

    def __init__(self, most: int, *, is_newest_kept: bool = False) -> None:
        self._most, self._is_newest_kept = most, is_newest_kept
        self._kept: deque[_T] = deque(maxlen=most)

    def __bool__(self) -> bool:
        """Whether anything is kept."""
        return bool(self._kept)

    def keep(self, *came: _T) -> None:
        """Keep what came, as far as there is room."""
        room = len(came) if self._is_newest_kept else self._most - len(self._kept)
        self._kept.extend(came[:room])

    def take(self) -> list[_T]:
        """Return what is kept, the oldest first, and keep it no longer."""
        taken = list(self._kept)
        self._kept.clear()
        return taken
