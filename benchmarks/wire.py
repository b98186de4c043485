"""Reads arrays from messages that were never deserialised."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float32MultiArray

from benchmarks.samples import CHANNELS

_VALUE_BYTES = 4


class ArrayReader:
    """Finds the data of one topic's ``Float32MultiArray`` in its CDR bytes.

    The layout is the same in all messages of a topic and the data comes last, so one
    deserialised message tells where it begins in every other one.
    """

    def __init__(self) -> None:
        self._offset = 0

    def first_value(self, message: bytes) -> float:
        """Return the first value."""
        return float(self._values(message, 1)[0])

    def first_channel(self, message: bytes) -> NDArray[np.float32]:
        """Return channel 0 of every sample of a chunk.

        Raises
        ------
        ValueError
            If the data is not an integer of samples.
        """
        return self._values(message, -1).reshape(-1, CHANNELS)[:, 0]

    def _values(self, message: bytes, count: int) -> NDArray[np.float32]:
        if not self._offset:
            whole = deserialize_message(message, Float32MultiArray)
            self._offset = len(message) - _VALUE_BYTES * len(whole.data)
        return np.frombuffer(message, "<f4", count, self._offset)
