"""Makes the messages of streams of numbers: raw and stamped."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biosensor_common.quantities import ChannelFormat, MessageType
from biosensor_common.stream_header import StreamHeader
from biosensor_gateway.recording.bag.types import typestore
from biosensor_gateway.recording.export.mcap.cdr import (
    ENCAPSULATION,
    aligned,
    cut,
    stamp,
    text,
    texts,
)

_DTYPES: dict[MessageType, np.dtype[Any]] = {
    MessageType.FLOAT32: np.dtype("<f4"),
    MessageType.FLOAT32_MULTI_ARRAY: np.dtype("<f4"),
    MessageType.FLOAT64_MULTI_ARRAY: np.dtype("<f8"),
    MessageType.INT32_MULTI_ARRAY: np.dtype("<i4"),
    MessageType.INT64_MULTI_ARRAY: np.dtype("<i8"),
    MessageType.UINT8: np.dtype("<u1"),
    MessageType.UINT16: np.dtype("<u2"),
}
# Nobody knows what was lost before the recorder.
_COUNTS = struct.Struct("<Qq?")
_UNKNOWN_LOSS = -1
_NO_VALUES = bytes(4)


class RawNumbers:
    """One message a sample, without a stamp."""

    def __init__(self, message_type: MessageType, channels: int) -> None:
        self._dtype = _DTYPES[message_type]
        self._limits = message_type.integer_range
        self._head = _array_head(message_type, channels) if message_type.is_array else ENCAPSULATION

    def fitting(self, values: NDArray[Any]) -> NDArray[np.bool_]:
        """Say of each sample whether the message can hold it.

        Parameters
        ----------
        values : ndarray, shape (n, n_channels)
        """
        if self._limits is None:
            return np.ones(len(values), np.bool_)
        low, high = self._limits
        return np.asarray(((values >= low) & (values <= high)).all(axis=1), np.bool_)

    def encode(self, values: NDArray[Any]) -> list[bytes]:
        """Return the messages of samples that fit."""
        size = self._dtype.itemsize * values.shape[1]
        rows = np.empty((len(values), len(self._head) + size), np.uint8)
        rows[:, : len(self._head)] = np.frombuffer(self._head, np.uint8)
        with np.errstate(over="ignore"):
            wire = np.ascontiguousarray(values, self._dtype)
        rows[:, len(self._head) :] = wire.view(np.uint8).reshape(len(values), size)
        return cut(rows.tobytes(), rows.shape[1])


def _array_head(message_type: MessageType, channels: int) -> bytes:
    """Return what stands before the values, which end the message."""
    kinds = typestore().types
    dimension = kinds["std_msgs/msg/MultiArrayDimension"](
        label="channels", size=channels, stride=channels
    )
    layout = kinds["std_msgs/msg/MultiArrayLayout"](dim=[dimension], data_offset=0)
    zeros = np.zeros(channels, _DTYPES[message_type])
    message = kinds[message_type.value](layout=layout, data=zeros)
    return bytes(typestore().serialize_cdr(message, message_type.value)[: -zeros.nbytes])


class StampedNumbers:
    """``biosensor_msgs/Samples``: one message for samples that came together."""

    def __init__(self, header: StreamHeader, frame_id: str) -> None:
        self._is_int64 = header.format is ChannelFormat.INT64
        self._frame = aligned(text(frame_id), 8)
        names = aligned(texts(header.labels), 4) + texts(header.units)
        # The counts before it end in one byte.
        self._names = bytes(3) + aligned(names, 4)

    def encode(self, unix_ns: NDArray[np.int64], values: NDArray[Any], sequence: int) -> bytes:
        """Return the message of some samples.

        Parameters
        ----------
        unix_ns : ndarray of int64, shape (n,)
        values : ndarray, shape (n, n_channels)
        sequence
            Number of the first.
        """
        offsets = (unix_ns - unix_ns[0]).tobytes()
        content = self._frame + _COUNTS.pack(sequence, _UNKNOWN_LOSS, False) + self._names
        content = _with_values(content, len(unix_ns), offsets)
        dtype = "<i8" if self._is_int64 else "<f8"
        wire = values.astype(dtype).tobytes()
        if self._is_int64:
            content = _with_values(content + _NO_VALUES, values.size, wire)
        else:
            content = _with_values(content, values.size, wire) + _NO_VALUES
        return ENCAPSULATION + stamp(int(unix_ns[0])) + content


def _with_values(content: bytes, count: int, values: bytes) -> bytes:
    """Append a sequence of values of 8 bytes each."""
    return aligned(content + count.to_bytes(4, "little"), 8) + values
