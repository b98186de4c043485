"""Reads from a socket, for as long as a study lasts."""

from __future__ import annotations

import socket

_LARGEST = 65536
"""Bytes of one read; no datagram is larger."""


class Receiver:
    """Reads from one socket, always into the same place.

    ``socket.recv`` makes room for the largest read each time and cuts it to the few bytes that
    came; what is left between the pieces lets a process grow by megabytes an hour.
    """

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._room = memoryview(bytearray(_LARGEST))

    def read(self) -> bytes:
        """Wait for the next bytes, as ``socket.recv`` does; raise what it raises."""
        return bytes(self._room[: self._socket.recv_into(self._room)])
