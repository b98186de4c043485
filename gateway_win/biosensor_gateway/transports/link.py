"""The interface of every byte-stream transport."""

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
