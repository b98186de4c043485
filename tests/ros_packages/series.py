"""The series that a plotting program can show: single numbers of declared topics."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from biosensor_common import naming
from biosensor_common.quantities import MessageType, Unit
from biosensor_common.spec import DeviceIdentity, StreamSpec
from biosensor_gateway.devices.registry import declaration

LAYOUTS = Path(__file__).parents[2] / "ros_side" / "lsl_to_ros" / "config" / "layouts"
SENSORS = (
    "empatica_e4",
    "emotiv_insight",
    "shimmer3_gsr",
    "polar_h10",
    "vernier_respiration_belt",
    "zephyr",
)
DIMENSIONLESS = frozenset({Unit.BOOLEAN, Unit.FRACTION, Unit.INDEX, Unit.NONE})
_FIELD = re.compile(r"data(?:\[(?P<index>\d+)\])?")


class Series(NamedTuple):
    """One channel of a stream; no channel where the message has no field at all."""

    topic: str
    channel: int | None


class Declared(NamedTuple):
    """A stream of one of the six sensors."""

    sensor: str
    stream: StreamSpec

    def series(self, topic: str) -> set[Series]:
        if not _fields(self.stream.message_type):
            return {Series(topic, None)}
        return {Series(topic, channel) for channel in range(len(self.stream.channels))}


def declared_topics() -> dict[str, Declared]:
    """All streams of the six sensors by their topics, in the root namespace."""
    return {
        f"/{naming.topic(DeviceIdentity(name, 'unit'), stream.data_name)}": Declared(name, stream)
        for name in SENSORS
        for stream in declaration(name).streams
    }


def read_series(topic: str, field: str) -> Series:
    """Check a topic and a field's path, ``data`` or ``data[2]``, and return what they name.

    The field's type is that of the ROS message, so that the path is right for it.
    """
    assert topic in declared_topics(), f"{topic} is no declared topic"
    stream = declared_topics()[topic].stream
    fields = _fields(stream.message_type)
    if not field:
        assert not fields, f"{topic} has fields: {fields}"
        return Series(topic, None)
    match = _FIELD.fullmatch(field)
    assert match, f"{topic}: {field} is no path to a number"
    is_array = fields["data"].startswith("sequence<")
    assert is_array == (match["index"] is not None), f"{topic} has {fields['data']}, not {field}"
    channel = int(match["index"] or 0)
    assert channel < len(stream.channels), f"{topic} has {len(stream.channels)} channels"
    return Series(topic, channel)


def unit(series: Series) -> str:
    stream = declared_topics()[series.topic].stream
    return stream.channels[series.channel or 0].unit


def label(series: Series) -> str:
    stream = declared_topics()[series.topic].stream
    return stream.channels[series.channel or 0].label


def _fields(message_type: MessageType) -> dict[str, str]:
    package, _, name = message_type.value.split("/")
    kind: Any = getattr(import_module(f"{package}.msg"), name)
    fields: dict[str, str] = dict(kind.get_fields_and_field_types())
    # A struct of C must not be empty; the message itself is.
    fields.pop("structure_needs_at_least_one_member", None)
    return fields
