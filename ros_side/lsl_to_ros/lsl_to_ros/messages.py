"""From samples to ROS messages."""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Callable, Sequence
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
    MultiArrayDimension,
    MultiArrayLayout,
    String,
    UInt8,
    UInt16,
)

from biosensor_common.quantities import MessageType

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

_TYPECODES = {
    MessageType.FLOAT64_MULTI_ARRAY: "d",
    MessageType.INT32_MULTI_ARRAY: "i",
    MessageType.INT64_MULTI_ARRAY: "q",
}

ToTime = Callable[[float], Time]
"""Turns a stamp of the sender's LSL clock into a ROS time."""

Builder = Callable[[Sequence[Any], float], Any]
"""Makes a message of one sample and its stamp; ValueError if the sample does not fit into it."""


def chunk_type(raw: MessageType) -> MessageType:
    """Message type of a stream's chunks; a wider raw type keeps its precision."""
    return raw if raw in _TYPECODES else MessageType.FLOAT32_MULTI_ARRAY


def typecode(message_type: MessageType) -> str:
    """Typecode of the :mod:`array` that a message's data is assigned from."""
    return _TYPECODES.get(message_type, "f")


def builder(message_type: MessageType, channels: int, to_time: ToTime) -> Builder:
    """Return what turns one sample of *channels* values into a message of that type."""
    if message_type.is_array:
        return _array_builder(message_type, channels)
    if message_type.integer_range is not None:
        return _integer_builder(message_type, *message_type.integer_range)
    if message_type is MessageType.DIAGNOSTIC_ARRAY:
        return _counters_builder(to_time)
    return _BUILDERS[message_type]


def chunk_message(message_type: MessageType, values: array[float], channels: int) -> Any:  # noqa: ANN401 - any array message
    """Make a chunk message; row-major, ``layout.dim`` = [samples, channels]."""
    dimensions = [
        MultiArrayDimension(label="samples", size=len(values) // channels, stride=len(values)),
        MultiArrayDimension(label="channels", size=channels, stride=channels),
    ]
    return CLASSES[message_type](layout=MultiArrayLayout(dim=dimensions), data=values)


def _array_builder(message_type: MessageType, channels: int) -> Builder:
    kind, code = CLASSES[message_type], typecode(message_type)
    dimension = MultiArrayDimension(label="channels", size=channels, stride=channels)
    layout = MultiArrayLayout(dim=[dimension])

    def build(sample: Sequence[Any], _: float) -> Any:  # noqa: ANN401 - any array message
        return kind(layout=layout, data=array(code, sample))

    return build


def _integer_builder(message_type: MessageType, low: int, high: int) -> Builder:
    kind = CLASSES[message_type]

    def build(sample: Sequence[Any], _: float) -> Any:  # noqa: ANN401 - any integer message
        value = sample[0]
        if not low <= value <= high:
            raise ValueError(f"{value} does not fit into {message_type}")
        return kind(data=int(value))

    return build


def _text(sample: Sequence[str], _: float) -> String:
    # Several strings in one message: JSON keeps them apart whatever they contain.
    return String(data=sample[0] if len(sample) == 1 else json.dumps(list(sample)))


def _float(sample: Sequence[float], _: float) -> Float32:
    return Float32(data=float(sample[0]))


def _empty(_: Sequence[str], _stamp: float) -> Empty:
    return Empty()


def _counters_builder(to_time: ToTime) -> Builder:
    def build(sample: Sequence[Any], stamp: float) -> DiagnosticArray:
        statuses = [
            DiagnosticStatus(
                level=DiagnosticStatus.OK,
                name=source_id,
                values=[KeyValue(key=key, value=str(value)) for key, value in counters.items()],
            )
            for source_id, counters in read_counters(sample[0]).items()
        ]
        return DiagnosticArray(header=Header(stamp=to_time(stamp)), status=statuses)

    return build


def read_counters(text: str) -> dict[str, dict[str, float]]:
    """Read one sample of the agent's counters stream: counters by source_id.

    Raises
    ------
    ValueError
        If it is not what an agent writes.
    """
    try:
        return {
            str(source_id): {key: _finite(entry[key]) for key in ("pushed", "lost", "last_stamp")}
            for source_id, entry in json.loads(text).items()
        }
    except (AttributeError, KeyError, OverflowError, RecursionError, TypeError) as error:
        raise ValueError("not the counters of an agent") from error


def _finite(number: Any) -> float:  # noqa: ANN401 - whatever JSON holds
    value = float(number)
    if not math.isfinite(value):
        raise ValueError(f"{number} is no counter")
    return value


_BUILDERS: dict[MessageType, Builder] = {
    MessageType.EMPTY: _empty,
    MessageType.FLOAT32: _float,
    MessageType.STRING: _text,
}
