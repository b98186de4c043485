"""Encodes messages of a fixed shape as the bytes that go over the wire.

All messages of a stream differ in their values only, and these come last. So ROS
serialises one message of each shape; every other one is its head and a sample's own
bytes. To fill and convert a message object costs several times as much.
"""

from __future__ import annotations

from array import array
from functools import lru_cache
from itertools import accumulate
from operator import mul
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from std_msgs.msg import MultiArrayDimension, MultiArrayLayout

from biosensor_common.quantities import MessageType
from lsl_to_ros.topics import messages

# Lengths may be changed at any time; a head of each that is in use.
_CHUNK_SHAPES = 256
# Of the common data representation, in which ROS serialises: it names the byte order.
_CDR_HEADER_BYTES = 4

_DTYPES = {
    MessageType.FLOAT32: np.dtype(np.float32),
    MessageType.FLOAT32_MULTI_ARRAY: np.dtype(np.float32),
    MessageType.FLOAT64_MULTI_ARRAY: np.dtype(np.float64),
    MessageType.INT32_MULTI_ARRAY: np.dtype(np.int32),
    MessageType.INT64_MULTI_ARRAY: np.dtype(np.int64),
    MessageType.UINT8: np.dtype(np.uint8),
    MessageType.UINT16: np.dtype(np.uint16),
}


def wire_dtype(message_type: MessageType) -> np.dtype[Any]:
    """Type of a message's values.

    Raises
    ------
    KeyError
        If the message holds no numbers.
    """
    return _DTYPES[message_type]


def to_bytes(samples: NDArray[Any], dtype: np.dtype[Any]) -> bytes:
    """Return samples as values of another type; a float too large for it becomes infinite."""
    if samples.dtype == dtype:
        return samples.tobytes()
    with np.errstate(over="ignore"):
        return samples.astype(dtype).tobytes()


class SampleEncoder:
    """Makes one message of each sample.

    Parameters
    ----------
    channels
        Values in one sample; 1 for a message that is no array.
    """

    def __init__(self, message_type: MessageType, channels: int) -> None:
        self._dtype = wire_dtype(message_type)
        self._size = channels * self._dtype.itemsize
        if message_type.is_array:
            layout = _layout(channels=channels)
            self._head, self._tail = _array_head(message_type, layout, channels), b""
        else:
            message = serialize_message(messages.CLASSES[message_type]())
            end = _CDR_HEADER_BYTES + self._size
            self._head, self._tail = message[:_CDR_HEADER_BYTES], message[end:]

    def encode(self, samples: NDArray[Any]) -> list[bytes]:
        """Return the messages of samples of shape [samples, channels]."""
        head, size, tail = self._head, self._size, self._tail
        values = to_bytes(samples, self._dtype)
        if len(values) == size:
            return [head + values + tail]
        return [head + values[at : at + size] + tail for at in range(0, len(values), size)]


def chunk_message(message_type: MessageType, values: bytes, channels: int) -> bytes:
    """Make a chunk of values in row-major order; ``layout.dim`` = [samples, channels]."""
    return _chunk_head(message_type, len(values), channels) + values


@lru_cache(_CHUNK_SHAPES)
def _chunk_head(message_type: MessageType, size: int, channels: int) -> bytes:
    count = size // wire_dtype(message_type).itemsize
    layout = _layout(samples=count // channels, channels=channels)
    return _array_head(message_type, layout, count)


def _array_head(message_type: MessageType, layout: MultiArrayLayout, count: int) -> bytes:
    """Return what stands before *count* values, which end an array's message."""
    dtype = wire_dtype(message_type)
    size = count * dtype.itemsize
    values = array(dtype.char, bytes(size))
    return serialize_message(messages.CLASSES[message_type](layout=layout, data=values))[:-size]


def _layout(**sizes: int) -> MultiArrayLayout:
    """Return the layout of an array; the stride of a dimension spans all that follow."""
    strides = accumulate(reversed(sizes.values()), mul)
    dimensions = [
        MultiArrayDimension(label=label, size=size, stride=stride)
        for (label, size), stride in zip(reversed(sizes.items()), strides, strict=True)
    ]
    return MultiArrayLayout(dim=dimensions[::-1])
