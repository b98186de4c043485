"""The parts of a bag."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag.

    Attributes
    ----------
    type_name
        Type of its messages, such as ``sensor_msgs/msg/Imu``.
    encoding
        Language of `definition`: ``ros2msg``, ``ros2idl``, or empty.
    definition
        Definition of the type and all types in it; empty if the bag does not contain it.
    qos
        QoS profiles of its publishers, as YAML.
    """

    name: str
    type_name: str
    encoding: str = ""
    definition: str = ""
    qos: str = ""


class Message(NamedTuple):
    """One serialised message of a bag; `unix_ns` is the time of recording."""

    topic: Topic
    unix_ns: int
    content: bytes


Note = Callable[[str], None]
"""Called with a sentence about something that cannot be read."""
