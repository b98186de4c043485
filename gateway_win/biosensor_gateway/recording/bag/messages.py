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
        Of its messages: ``sensor_msgs/msg/Imu``.
    encoding
        In which language `definition` is: ``ros2msg``, ``ros2idl``, or empty.
    definition
        Of the type and all that it needs; empty if the bag does not have it.
    qos
        What its publishers offered, as YAML.
    """

    name: str
    type_name: str
    encoding: str = ""
    definition: str = ""
    qos: str = ""


class Message(NamedTuple):
    """One message of a bag, serialised; `unix_ns` is when it was recorded."""

    topic: Topic
    unix_ns: int
    content: bytes


Note = Callable[[str], None]
"""Takes a sentence about what cannot be read."""
