"""Finds the classes of ROS messages by the names that streams give them."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import BatteryState, Imu, MagneticField, Temperature
from std_msgs.msg import (
    Empty,
    Float32,
    Float32MultiArray,
    Float64MultiArray,
    Int32MultiArray,
    Int64MultiArray,
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
STANDARD_CLASSES: dict[str, type[Any]] = {
    f"sensor_msgs/msg/{each.__name__}": each
    for each in (BatteryState, Imu, MagneticField, Temperature)
}
"""Of what a stream has beside its own topics: see `biosensor_common.ros.standard_messages`."""


def _own() -> dict[bool, type[Any]]:
    try:
        own = import_module("biosensor_msgs.msg")
    except ImportError:
        # nothing is dropped: the reports say that there are no stamped topics
        return {}
    return {True: own.Event, False: own.Samples}


_OWN = _own()
HAS_STAMPED_TOPICS = bool(_OWN)
"""Whether the package ``biosensor_msgs``, which has to be built, can be imported."""


def stamped_class(message_type: MessageType) -> type[Any]:
    """Return what a stream's stamped topic carries: ``Event`` of text, else ``Samples``.

    Raises
    ------
    KeyError
        If there are no stamped topics.
    """
    return _OWN[message_type.is_text]
