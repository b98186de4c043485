"""Reads from a socket, for as long as a study lasts."""

from __future__ import annotations

import socket

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
