"""Cuts the bytes of the reading process into what they mean."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biosensor_common.errors import ProtocolError, ProtocolReason

_HEAD = struct.Struct("<cBI")
_SAMPLES = struct.Struct("<dI")
_MOST_BYTES = 1 << 28
"""More than BrainFlow keeps of any board."""


@dataclass(frozen=True, slots=True)
class Rows:
    """What a preset has measured since the last.

    Attributes
    ----------
    now_s
        The computer's time of day when they were handed on, in seconds; BrainFlow's own stamps
        are of the same clock.
    values : array, shape (n_rows, n_samples)
    """

    preset: int
    now_s: float
    values: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Told:
    """What the process says of itself; empty for its sign of life."""

    what: dict[str, Any]


class Frames:
    """Takes bytes in any pieces."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def feed(self, data: bytes) -> Iterator[Rows | Told]:
        """Return what is complete now.

        Raises
        ------
        ProtocolError
            ``GARBAGE``: it is no frame; what comes after it cannot be read.
        """
        self._waiting += data
        while len(self._waiting) >= _HEAD.size:
            kind, preset, length = _HEAD.unpack_from(self._waiting)
            if kind not in b"JSB" or length > _MOST_BYTES:
                raise _garbage()
            end = _HEAD.size + length
            if len(self._waiting) < end:
                return
            content = bytes(self._waiting[_HEAD.size : end])
            del self._waiting[:end]
            yield _read(kind, preset, content)


def _read(kind: bytes, preset: int, content: bytes) -> Rows | Told:
    try:
        if kind == b"B":
            return Told({})
        if kind == b"J":
            return Told(dict(json.loads(content)))
        now_s, count = _SAMPLES.unpack_from(content)
        values = np.frombuffer(content, "<f8", offset=_SAMPLES.size)
        return Rows(preset, now_s, values.reshape(count, -1))
    except (ValueError, TypeError, struct.error) as error:
        raise _garbage() from error


def _garbage() -> ProtocolError:
    message = "what reads the board sent something that is no frame; it is started anew"
    return ProtocolError(ProtocolReason.GARBAGE, message)
