"""Finds ROS messages by the names that streams give them, and builds those of text."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import (
    Empty,
    Float32,
    Float32MultiArray,
    Float64MultiArray,
    Header,
    Int32MultiArray,
    Int64MultiArray,
    String,
    UInt8,
    UInt16,
)

from biosensor_common.quantities import MessageType
from biosensor_common.topic_text import Sample, read_counters, text_of

CLASSES: dict[MessageType, type[Any]] = {
    MessageType.DIAGNOSTIC_ARRAY: DiagnosticArray,
    MessageType.EMPTY: Empty,
    MessageType.FLOAT32: Float32,
    MessageType.FLOAT32_MULTI_ARRAY: Float32MultiArray,
    MessageType.FLOAT64_MULTI_ARRAY: Float64MultiArray,
    MessageType.INT32_MULTI_ARRAY: Int32MultiArray,
    MessageType.INT64_MULTI_ARRAY: Int64MultiArray,
    MessageType.STRING: String,
    MessageType.UINT8: UInt8,
    MessageType.UINT16: UInt16,
}


def text_builder(message_type: MessageType) -> Callable[[Sample], Empty | String]:
    """Return what makes a message of one sample of text.

    Raises
    ------
    KeyError
        If it is no such message type.
    """
    return _TEXT_BUILDERS[message_type]


def counters_message(text: str, stamp: Time) -> DiagnosticArray:
    """Make a message of one sample of the agent's counters.

    Raises
    ------
    ValueError
        If it is not what an agent writes.
    """
    statuses = [
        DiagnosticStatus(
            level=DiagnosticStatus.OK,
            name=source_id,
            values=[KeyValue(key=key, value=str(value)) for key, value in counters.items()],
        )
        for source_id, counters in read_counters(text).items()
    ]
    return DiagnosticArray(header=Header(stamp=stamp), status=statuses)


_TEXT_BUILDERS: dict[MessageType, Callable[[Sample], Empty | String]] = {
    MessageType.EMPTY: lambda _: Empty(),
    MessageType.STRING: lambda sample: String(data=text_of(sample)),
}
