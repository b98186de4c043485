"""Lines of JSON over TCP, limited in size and time, each sealed once there is a key."""

from __future__ import annotations

import json
import socket
import time
from typing import Any, cast

from biosensor_common.doctor.two_sided.code import is_sealed, seal
from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)

MAX_GREETING = 1024
"""Bytes of a line from somebody who has not proved anything yet."""
MAX_LINE = 256 * 1024
_READ = 16 * 1024
_SEAL = 64

Message = dict[str, Any]


class Channel:
    """One end of a conversation; closing it is the caller's.

    Parameters
    ----------
    name
        What a sentence calls the other end.
    """

    def __init__(self, connection: socket.socket, name: str) -> None:
        self.connection = connection
        self.name = name
        self._rest = b""
        self._key: bytes | None = None
        self._own = self._other = b""
        self._sent = self._received = 0

    def secure(self, key: bytes, own: bytes, other: bytes) -> None:
        """Seal all that follows; *own* and *other* tell the two directions apart."""
        self._key, self._own, self._other = key, own, other

    def send(self, message: Message, limit_s: float = 10.0) -> None:
        """Send a line.

        Raises
        ------
        TransportError
            ``LOST`` or ``SILENT``.
        """
        line = json.dumps(message).encode("ascii")
        if self._key is not None:
            line = seal(self._key, _sealed(self._own, self._sent, line)).encode("ascii") + line
            self._sent += 1
        self.connection.settimeout(limit_s)
        try:
            self.connection.sendall(line + b"\n")
        except TimeoutError as error:
            raise self._silent(limit_s) from error
        except OSError as error:
            raise self._lost() from error

    def receive(self, limit_s: float) -> Message:
        """Wait for a line.

        Raises
        ------
        TransportError
            ``LOST`` if the other end is gone, ``SILENT`` if the line is not there in time.
        ProtocolError
            ``GARBAGE`` for what is too long, not sealed with the key, or no JSON object.
        """
        line = self._line(limit_s)
        if self._key is not None:
            given, line = line[:_SEAL].decode("ascii", "replace"), line[_SEAL:]
            if not is_sealed(self._key, _sealed(self._other, self._received, line), given):
                raise self._garbage("a line that it did not seal itself")
            self._received += 1
        try:
            message: object = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise self._garbage("a line that is no JSON") from error
        if not isinstance(message, dict):
            raise self._garbage("a line that is no JSON object")
        return cast("Message", message)

    def _line(self, limit_s: float) -> bytes:
        end = time.monotonic() + limit_s
        most = MAX_GREETING if self._key is None else MAX_LINE
        while b"\n" not in self._rest:
            if len(self._rest) > most:
                raise self._garbage(f"a line of more than {most} bytes")
            left = end - time.monotonic()
            if left <= 0:
                raise self._silent(limit_s)
            self.connection.settimeout(left)
            try:
                read = self.connection.recv(_READ)
            except TimeoutError as error:
                raise self._silent(limit_s) from error
            except OSError as error:
                raise self._lost() from error
            if not read:
                raise self._lost()
            self._rest += read
        line, _, self._rest = self._rest.partition(b"\n")
        if len(line) > most:
            raise self._garbage(f"a line of more than {most} bytes")
        return line

    def _silent(self, limit_s: float) -> TransportError:
        return TransportError(
            TransportReason.SILENT,
            f"{self.name} said nothing for {limit_s:g} s; start both sides again",
        )

    def _lost(self) -> TransportError:
        return TransportError(
            TransportReason.LOST, f"{self.name} ended the conversation; start both sides again"
        )

    def _garbage(self, what: str) -> ProtocolError:
        return ProtocolError(
            ProtocolReason.GARBAGE,
            f"{self.name} sent {what}; another program seems to be at that port",
        )


def _sealed(direction: bytes, number: int, line: bytes) -> bytes:
    return b"%s %d " % (direction, number) + line
