"""Interfaces of byte and text links, a reader of sockets, and a queue for early messages."""

from __future__ import annotations

import socket
from collections import deque
from typing import Generic, NamedTuple, Protocol, TypeVar

_LARGEST = 65536
"""Bytes of one read; no datagram is larger."""
Address = tuple[str, int]


class Receiver:
    """Reads from one socket into one reused buffer.

    ``socket.recv`` allocates memory for the largest read each time and shrinks it to the few bytes
    that arrived; the fragmentation makes a process grow by megabytes per hour.
    """

    def __init__(self, source: socket.socket) -> None:
        self._socket = source
        self._room = memoryview(bytearray(_LARGEST))

    def read(self) -> bytes:
        """Wait for the next bytes, like ``socket.recv``, with the same exceptions."""
        return bytes(self._room[: self._socket.recv_into(self._room)])

    def read_from(self) -> tuple[bytes, Address]:
        """Wait for the next datagram and return its sender, like ``socket.recvfrom``."""
        size, address = self._socket.recvfrom_into(self._room)
        return bytes(self._room[:size]), (address[0], address[1])


class Received(NamedTuple):
    """Bytes and the LSL time at which they arrived."""

    data: bytes
    arrival: float


class ByteLink(Protocol):
    """Reads and writes bytes, without interpreting them."""

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
            ``LOST``, after everything that had arrived was read.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send without waiting; a failure is raised by ``read``."""
        ...

    async def close(self) -> None:
        """Send queued bytes within a short time limit, and close; never raises."""
        ...


class ReceivedText(NamedTuple):
    """A message and the LSL time at which it arrived."""

    text: str
    arrival: float


class TextLink(Protocol):
    """Reads and writes whole text messages."""

    @property
    def dropped(self) -> int:
        """Number of messages that were discarded because the queue was full."""
        ...

    async def open(self) -> None:
        """Connect.

        Raises
        ------
        TransportError, ConfigError
            Nothing listens there, the connection is refused, or the peer or address is wrong.
        """
        ...

    async def read(self) -> ReceivedText:
        """Wait for the next message.

        Raises
        ------
        TransportError
            ``LOST``, after everything that had arrived was read.
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
    """Queue of messages that arrived too early to be processed.

    A device may send before its driver has identified it, or before its clock is known; these
    measurements should not be lost.

    Parameters
    ----------
    most
        Capacity of the queue.
    is_newest_kept
        Whether a full queue discards its oldest message; otherwise it discards new ones, so that
        nothing is missing between the kept ones.
    """

    def __init__(self, most: int, *, is_newest_kept: bool = False) -> None:
        self._most, self._is_newest_kept = most, is_newest_kept
        self._kept: deque[_T] = deque(maxlen=most)

    def __bool__(self) -> bool:
        """Whether there are messages."""
        return bool(self._kept)

    def keep(self, *came: _T) -> None:
        """Add messages, as far as there is room."""
        room = len(came) if self._is_newest_kept else self._most - len(self._kept)
        self._kept.extend(came[:room])

    def take(self) -> list[_T]:
        """Remove and return all messages, the oldest first."""
        taken = list(self._kept)
        self._kept.clear()
        return taken
