"""Finds ROS messages by the names that streams give them, and builds those of text."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from numpy.typing import NDArray
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

_CLOCK = "clock_"
CLOCK_FACTS = ("offset_s", "drift_ppm", "residual_rms_s", "reanchors")
"""What an agent tells of a device's clock: see `biosensor_common.device_clock.ClockState`."""

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

Sample = Sequence[Any] | NDArray[Any]
"""Values of one sample, one a channel."""


def chunk_type(raw: MessageType) -> MessageType:
    """Message type of a stream's chunks; a wider raw type keeps its precision."""
    return raw if raw in _WIDE else MessageType.FLOAT32_MULTI_ARRAY


def text_of(sample: Sample) -> str:
    """Return a sample of text as one string; several are a JSON list."""
    # JSON keeps them apart whatever they contain.
    return str(sample[0]) if len(sample) == 1 else json.dumps(list(sample))


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


def read_counters(text: str) -> dict[str, dict[str, float]]:
    """Read one sample of the agent's counters stream: counters by source_id.

    The entry of one stream of a device has the state of the device's clock as well, under
    ``clock_`` and the names of `CLOCK_FACTS`.

    Raises
    ------
    ValueError
        If it is not what an agent writes.
    """
    try:
        return {str(source_id): _numbers(entry) for source_id, entry in json.loads(text).items()}
    except (AttributeError, KeyError, OverflowError, RecursionError, TypeError) as error:
        raise ValueError("not the counters of an agent") from error


def clock_of(counters: Mapping[str, float]) -> dict[str, float]:
    """Return the state of a device's clock by `CLOCK_FACTS`, of one entry of the counters."""
    told = ((key, counters.get(f"{_CLOCK}{key}")) for key in CLOCK_FACTS)
    return {key: value for key, value in told if value is not None}


def _numbers(entry: Any) -> dict[str, float]:  # noqa: ANN401 - whatever JSON holds
    counters = {key: _finite(entry[key]) for key in ("pushed", "lost", "last_stamp")}
    clock = entry.get("clock", {})
    return counters | {f"{_CLOCK}{key}": _finite(clock[key]) for key in CLOCK_FACTS if key in clock}


def _finite(number: Any) -> float:  # noqa: ANN401 - whatever JSON holds
    value = float(number)
    if not math.isfinite(value):
        raise ValueError(f"{number} is no counter")
    return value


_WIDE = frozenset(
    {
        MessageType.FLOAT64_MULTI_ARRAY,
        MessageType.INT32_MULTI_ARRAY,
        MessageType.INT64_MULTI_ARRAY,
    }
)
_TEXT_BUILDERS: dict[MessageType, Callable[[Sample], Empty | String]] = {
    MessageType.EMPTY: lambda _: Empty(),
    MessageType.STRING: lambda sample: String(data=text_of(sample)),
}
