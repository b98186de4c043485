"""Serialises messages as CDR.

The bytes are those of ``serialize_message`` of ROS: the common data representation (OMG,
DDSI-RTPS 2.5, 10.2), little-endian. Filling a message object and serialising it takes several
times as long with rclpy and ten times as long with a bag library, and a recording of two hours
has 14 million messages.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biosensor_common.ros_clock import NS_PER_S

ENCAPSULATION = b"\x00\x01\x00\x00"
"""Header with the byte order; alignment counts from its end."""

_STAMP = struct.Struct("<iI")
_STAMP_BYTES = 8


def text(value: str) -> bytes:
    """Serialise a string at an aligned position, with its length."""
    content = value.encode("utf-8", "surrogatepass") + b"\0"
    return len(content).to_bytes(4, "little") + content


def aligned(content: bytes, size: int) -> bytes:
    """Pad content that begins at an aligned position to the next one."""
    return content + bytes(-len(content) % size)


def texts(values: Sequence[str]) -> bytes:
    """Serialise a sequence of strings at an aligned position."""
    content = len(values).to_bytes(4, "little")
    for value in values:
        content = aligned(content, 4) + text(value)
    return content


def stamp(unix_ns: int) -> bytes:
    """Serialise a ``builtin_interfaces/Time``."""
    return _STAMP.pack(*divmod(unix_ns, NS_PER_S))


class HeadedRows:
    """Serialises messages of a header, a fixed number of values and a constant tail.

    Parameters
    ----------
    columns
        Number of values.
    tail
        Bytes after the values.
    """

    def __init__(
        self, frame_id: str, dtype: np.dtype[Any], columns: int, tail: bytes = b""
    ) -> None:
        # The frame's name follows the stamp, whose size keeps the alignment.
        self._frame = aligned(text(frame_id), dtype.itemsize)
        self._tail = tail
        parts: list[tuple[Any, ...]] = [
            ("encapsulation", f"V{len(ENCAPSULATION)}"),
            ("sec", "<i4"),
            ("nanosec", "<u4"),
            ("frame", f"V{len(self._frame)}"),
            ("values", dtype, (columns,)),
        ]
        if tail:
            parts.append(("tail", f"V{len(tail)}"))
        self._record = np.dtype(parts)

    def encode(self, unix_ns: NDArray[np.int64], values: NDArray[Any]) -> list[bytes]:
        """Serialise one message per row.

        Parameters
        ----------
        unix_ns : ndarray of int64, shape (n,)
            Stamps.
        values : ndarray, shape (n, columns)
        """
        rows = np.empty(len(unix_ns), self._record)
        rows["encapsulation"] = np.void(ENCAPSULATION)
        rows["sec"], rows["nanosec"] = np.divmod(unix_ns, NS_PER_S)
        rows["frame"] = np.void(self._frame)
        rows["values"] = values
        if self._tail:
            rows["tail"] = np.void(self._tail)
        return cut(rows.tobytes(), self._record.itemsize)


def cut(content: bytes, size: int) -> list[bytes]:
    """Split consecutive messages of one size."""
    return [content[at : at + size] for at in range(0, len(content), size)]
