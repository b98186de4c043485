"""Puts parts of messages together as the bytes that go over the wire.

They are those of the common data representation (OMG, DDSI-RTPS 2.5, 10.2), little-endian, as
``serialize_message`` of ROS gives them. To fill an object and have it serialised costs
several times as much with rclpy and ten times with a library for bags, and a recording of two hours
makes 14 million messages.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biosensor_common.ros_clock import NS_PER_S

ENCAPSULATION = b"\x00\x01\x00\x00"
"""Names the byte order; what is aligned, is from behind it."""

_STAMP = struct.Struct("<iI")
_STAMP_BYTES = 8


def text(value: str) -> bytes:
    """Return a string at an aligned place, with its length."""
    content = value.encode("utf-8", "surrogatepass") + b"\0"
    return len(content).to_bytes(4, "little") + content


def aligned(content: bytes, size: int) -> bytes:
    """Return content that begins at an aligned place, filled up to the next one."""
    return content + bytes(-len(content) % size)


def texts(values: Sequence[str]) -> bytes:
    """Return a sequence of strings at an aligned place."""
    content = len(values).to_bytes(4, "little")
    for value in values:
        content = aligned(content, 4) + text(value)
    return content


def stamp(unix_ns: int) -> bytes:
    """Return a ``builtin_interfaces/Time``."""
    return _STAMP.pack(*divmod(unix_ns, NS_PER_S))


class HeadedRows:
    """Messages of a header, a fixed number of values, and an end that is always the same.

    Parameters
    ----------
    frame_id
        Of the header.
    dtype
        Of the values.
    columns
        How many.
    tail
        What follows them.
    """

    def __init__(
        self, frame_id: str, dtype: np.dtype[Any], columns: int, tail: bytes = b""
    ) -> None:
        # The frame's name stands behind the stamp, whose size is aligned itself.
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
        """Return a message of each row.

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
    """Return the messages of one size that stand behind each other."""
    return [content[at : at + size] for at in range(0, len(content), size)]
