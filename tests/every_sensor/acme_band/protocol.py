"""The frames of an Acme Band: marker, number, force, worn, battery and a sum, eight bytes."""

from __future__ import annotations

import struct
from typing import NamedTuple

START, STOP = b"S", b"X"
_MARKER = 0xAC
_FRAME = struct.Struct("<BHhBBB")
_NOT_WORN = -(2**15)


class Sample(NamedTuple):
    """One frame; *force_n* is NaN off the body, *number* turns over at 65536."""

    number: int
    force_n: float
    worn: bool
    battery_percent: int


class AcmeProtocol:
    """Bytes in, samples out."""

    def __init__(self) -> None:
        self.dropped_bytes = 0
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Sample]:
        """Return the samples that are complete; what is no frame is dropped and counted."""
        self._buffer += data
        samples: list[Sample] = []
        while len(self._buffer) >= _FRAME.size:
            frame = bytes(self._buffer[: _FRAME.size])
            if frame[0] == _MARKER and sum(frame[:-1]) % 256 == frame[-1]:
                _, number, force, worn, battery, _ = _FRAME.unpack(frame)
                newtons = float("nan") if force == _NOT_WORN else force / 100
                samples.append(Sample(number, newtons, bool(worn), battery))
                del self._buffer[: _FRAME.size]
            else:
                self.dropped_bytes += 1
                del self._buffer[:1]
        return samples
