"""The parts of a bag, its errors, and definitions of messages: ROS 2 Jazzy's and ours."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum, unique
from functools import cache
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.base import normalize_fieldname
from rosbags.typesys.store import Typestore

from biosensor_common.errors import GatewayError
from biosensor_common.ros.fields import Definition, Slot


@unique
class BagReason(Enum):
    """Why a bag cannot be read at all."""

    NOT_FOUND = "not_found"
    UNREADABLE = "unreadable"
    NOT_A_BAG = "not_a_bag"
    EMPTY = "empty"
    """It contains nothing that fits a recording."""
    EXISTS = "exists"
    """The output file exists."""
    UNWRITABLE = "unwritable"
    """The output file cannot be written."""


class BagError(GatewayError):
    """The bag cannot be read, or no file can be written from it."""


class MessageError(Exception):
    """A message or its type is invalid; the text is the end of a sentence."""


class UnsuitableError(MessageError):
    """No message of a topic fits a recording; the text is the end of a sentence."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag."""

    name: str
    type_name: str  # Type of its messages, such as `sensor_msgs/msg/Imu`.
    encoding: str = ""  # Language of `definition`: `ros2msg`, `ros2idl`, or empty.
    # Definition of the type and all types in it; empty if the bag does not contain it.
    definition: str = ""
    qos: str = ""  # QoS profiles of its publishers, as YAML.


class Message(NamedTuple):
    """One serialised message of a bag; `unix_ns` is the time of recording."""

    topic: Topic
    unix_ns: int
    content: bytes


Note = Callable[[str], None]
"""Called with a sentence about something that cannot be read."""
_ARRAYS = (Nodetype.ARRAY, Nodetype.SEQUENCE)
SAMPLES = "biosensor_msgs/msg/Samples"
EVENT = "biosensor_msgs/msg/Event"
# Copied from the files in ros_side/biosensor_msgs, which document the fields but are not installed
# with the agent.
OWN = {
    EVENT: "std_msgs/Header header\nuint64 sequence\nstring data\n",
    SAMPLES: (
        "std_msgs/Header header\nuint64 sequence\nint64 lost\nbool lost_is_estimated\n"
        "string[] labels\nstring[] units\nint64[] offsets_ns\nfloat64[] data\nint64[] integers\n"
    ),
}
# Types whose fields are accessed by name, so a bag's definition must have these fields. This is
# also true for Time and Duration, but the library rejects any other definition of them.
_READ_BY_NAME = (*OWN, "std_msgs/msg/Header")


@cache
def typestore() -> Typestore:
    """Return the definitions of ROS 2 Jazzy and our own."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in OWN.items():
        store.register(get_types_from_msg(text, name))
    return store


class MessageType:
    """Deserialises the messages of one type, as the bag defines it.

    Parameters
    ----------
    topic
        The topic with this type; without a definition in the bag, that of ROS 2 Jazzy is used.

    Raises
    ------
    MessageError
        If the type is unknown, or its definition is invalid.
    """

    def __init__(self, topic: Topic) -> None:
        self.name = topic.type_name
        self._store = _defined(topic) if topic.definition else typestore()
        self._require(self.name, ())

    @property
    def definition(self) -> Definition:
        """The fields of a message."""
        return _Stored(self._store, self.name)

    def _require(self, name: str, within: tuple[str, ...]) -> None:
        """Check that a type and all types in it are known, and that it does not contain itself."""
        if name not in self._store.fielddefs:
            raise MessageError(f"the type {name} is unknown, and the bag does not define it")
        if name in within:
            raise MessageError(f"the type {name} contains itself")
        if name in _READ_BY_NAME:
            self._require_fields(name)
        fields: Any = self._store.fielddefs[name][1]
        for _, (node, what) in fields:
            inner_node, inner = what[0] if node in _ARRAYS else (node, what)
            if inner_node is Nodetype.NAME:
                self._require(inner, (*within, name))

    def _require_fields(self, name: str) -> None:
        """Check that a type has its standard fields; additional fields are allowed."""
        defined = dict(self._store.fielddefs[name][1])
        for field, what in typestore().fielddefs[name][1]:
            if defined.get(field) != what:
                text = f"the bag defines {name} without the field {field}, or with another type"
                raise MessageError(text)

    def read(self, content: bytes) -> Any:
        """Return a message as an object.

        Raises
        ------
        MessageError
            If it cannot be deserialised.
        """
        try:
            return self._store.deserialize_cdr(content, self.name)
        except (SerdeError, IndexError, OverflowError, MemoryError) as error:
            raise MessageError(f"it is not a {self.name}") from error


class _Stored:
    """The definition of a type in a typestore."""

    def __init__(self, store: Typestore, name: str) -> None:
        self._store, self.name = store, name

    def slots(self) -> Iterator[Slot]:
        definition: Any = self._store.fielddefs[self.name]
        constants, fields = definition
        for field, (node, what) in fields:
            is_array = node in _ARRAYS
            inner, bound = what if is_array else ((node, what), 0)
            is_message = inner[0] is Nodetype.NAME
            prefix = f"{field.upper()}_"
            yield Slot(
                normalize_fieldname(field),
                "" if is_message else inner[1][0],
                _Stored(self._store, inner[1]) if is_message else None,
                size=(bound if node is Nodetype.ARRAY else None) if is_array else 1,
                is_array=is_array,
                has_limit=is_array and bool(bound),
                values={
                    value: name.removeprefix(prefix)
                    for name, _, value in constants
                    if name.startswith(prefix) and type(value) is int
                },
            )


def _defined(topic: Topic) -> Typestore:
    store = get_typestore(Stores.EMPTY)
    try:
        if topic.encoding == "ros2idl":
            for part in topic.definition.split(_SEPARATOR):
                if idl := part.partition("\n")[2]:
                    store.register(get_types_from_idl(idl))
        else:
            store.register(get_types_from_msg(topic.definition, topic.type_name))
    except (TypesysError, ValueError, KeyError, SyntaxError) as error:
        raise MessageError(f"the definition of {topic.type_name} cannot be read") from error
    return store


# Separates the files in a definition; the first line after it is a title.
_SEPARATOR = "=" * 80 + "\n"
