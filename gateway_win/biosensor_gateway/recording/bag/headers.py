"""Creates the header of an LSL stream from the information about a topic in a bag.

A bag that was exported from a recording has a topic with the headers and clocks of that recording.
A bag's messages contain neither the header of a stream nor its clock. The topic is latched. Its
first text, ``recording``, has the start time of the recording and the relation between the
recorder's LSL clock and Unix time. One text per stream, ``stream``, follows: with the header as
recorded, the clock offsets, and the topics with the samples. It is a topic and not metadata,
because programs that cut, join or convert bags keep topics.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast
from xml.etree import ElementTree as ET

import numpy as np

from biosensor_common import naming
from biosensor_common.lsl_header import MAX_CHANNELS, xml_text
from biosensor_common.quantities import Category, ChannelFormat, MessageType
from biosensor_common.ros_clock import NS_PER_S
from biosensor_common.spec import DeviceIdentity, is_data_name
from biosensor_gateway.recording.bag.types import MessageError
from biosensor_gateway.recording.contents.wall_clock import WallClock

TOPIC = "/biosensors/recorded_streams"


# The topics of devices have more than two parts and never begin like this.
@dataclass(frozen=True, slots=True)
class RecordedClock:
    """The start time and the clock of the recording."""

    begun: str  # The recorder's text for the start time.
    wall: WallClock  # Relation between the recorder's LSL clock and Unix time.


@dataclass(frozen=True, slots=True)
class RecordedStream:
    """One stream of the recording."""

    number: int
    stamped: str  # The topic that has its samples with timestamps.
    topics: tuple[str, ...]
    xml: str
    # Pairs of LSL time on the stream's clock and offset to the recorder's clock, in s.
    clock_offsets: tuple[tuple[float, float], ...]


def clock_text(recorded: RecordedClock) -> str:
    """Return the topic's text for a recording."""
    wall = recorded.wall
    pairs = zip(wall.times.tolist(), wall.offsets_ns.tolist(), strict=True)
    clock = [[lsl_s, round(lsl_s * NS_PER_S) + offset_ns] for lsl_s, offset_ns in pairs]
    content = {"begun": recorded.begun, "source": wall.source, "resolution_s": wall.resolution_s}
    return json.dumps({"recording": content | {"clock": clock}})


def stream_text(stream: RecordedStream) -> str:
    """Return the topic's text for a stream."""
    content = {
        "number": stream.number,
        "stamped": stream.stamped,
        "topics": stream.topics,
        "header": stream.xml,
        "clock_offsets": stream.clock_offsets,
    }
    return json.dumps({"stream": content})


def read_text(text: str) -> RecordedClock | RecordedStream:
    """Read one text of the topic.

    Raises
    ------
    ValueError
        If it is invalid.
    """
    try:
        content = json.loads(text)
        if "recording" in content:
            return _clock(content["recording"])
        return _stream(content["stream"])
    except (AttributeError, KeyError, OverflowError, RecursionError, TypeError) as error:
        raise ValueError("it does not describe a recording") from error


def _clock(content: dict[str, Any]) -> RecordedClock:
    pairs = cast("Sequence[tuple[float, int]]", content["clock"])
    times = np.array([float(lsl_s) for lsl_s, _ in pairs])
    offsets_ns = np.array([int(ns) - round(lsl_s * NS_PER_S) for lsl_s, ns in pairs], np.int64)
    if not len(times) or not np.isfinite(times).all() or (np.diff(times) < 0).any():
        raise ValueError("its clock is invalid")
    source, resolution_s = str(content["source"]), float(content["resolution_s"])
    return RecordedClock(str(content["begun"]), WallClock(source, resolution_s, times, offsets_ns))


def _stream(content: dict[str, Any]) -> RecordedStream:
    offsets = tuple((float(at), float(offset)) for at, offset in content["clock_offsets"])
    if not np.isfinite(np.array(offsets)).all():
        raise ValueError("its clock offsets are not numbers")
    return RecordedStream(
        number=int(content["number"]),
        stamped=str(content["stamped"]),
        topics=tuple(map(str, content["topics"])),
        xml=str(content["header"]),
        clock_offsets=offsets,
    )


LATCHED = re.compile(r"durability:\s*(?:transient_local|1)\b")
STAMPED = "_stamped"
_FORMATS = {
    MessageType.FLOAT32: ChannelFormat.FLOAT32,
    MessageType.FLOAT32_MULTI_ARRAY: ChannelFormat.FLOAT32,
    MessageType.INT32_MULTI_ARRAY: ChannelFormat.INT32,
    MessageType.INT64_MULTI_ARRAY: ChannelFormat.INT64,
    MessageType.UINT8: ChannelFormat.INT16,
    MessageType.UINT16: ChannelFormat.INT32,
}


@dataclass(frozen=True, slots=True)
class Origin:
    """Where the samples of a stream come from."""

    topic: str
    type_name: str
    stamp_source: str  # Origin of the timestamps: `header` or `log`.


@dataclass(frozen=True, slots=True)
class Facts:
    """The known facts about a stream."""

    name: str
    content_type: str
    source_id: str
    host: str
    rate: float
    format: ChannelFormat
    labels: tuple[str, ...]
    units: tuple[str, ...] = ()
    # The `<biosensor>` data of one of our streams; empty for another program's.
    block: tuple[tuple[str, str], ...] = ()


def header_xml(facts: Facts, origin: Origin) -> str:
    """Return the XML header of a stream, as a recorder writes it."""
    info = ET.Element("info")
    _fill(
        info,
        name=facts.name,
        type=facts.content_type,
        channel_count=str(len(facts.labels)),
        nominal_srate=repr(facts.rate),
        channel_format=facts.format.value,
        source_id=facts.source_id,
        hostname=facts.host,
    )
    desc = ET.SubElement(info, "desc")
    channels = ET.SubElement(desc, "channels")
    for label, unit in zip(facts.labels, facts.units or [""] * len(facts.labels), strict=True):
        _fill(ET.SubElement(channels, "channel"), label=label, unit=unit, type=facts.content_type)
    if facts.rate:
        _fill(ET.SubElement(desc, "synchronization"), can_drop_samples="true")
    ros = {"topic": origin.topic, "type": origin.type_name, "stamp_source": origin.stamp_source}
    _fill(ET.SubElement(desc, "ros"), **ros)
    if facts.block:
        _fill(ET.SubElement(desc, "biosensor"), **dict(facts.block))
    return '<?xml version="1.0"?>' + ET.tostring(info, encoding="unicode")


def _fill(parent: ET.Element, **fields: str) -> None:
    for name, text in fields.items():
        ET.SubElement(parent, name).text = xml_text(text)


def facts_of_topic(
    topic: str,
    type_name: str,
    channels: Sequence[tuple[str, str]],
    form: ChannelFormat,
    shapes_before: int,
) -> Facts:
    """Return the facts about any node's topic, from its name and the fields of its type.

    Parameters
    ----------
    channels
        Label and unit of each channel.
    shapes_before
        Number of earlier streams of this topic, whose messages had another shape.
    """
    name = topic.strip("/")
    source_id = f"{topic}-{shapes_before + 1}" if shapes_before else topic
    labels, units = (tuple(each) for each in zip(*channels, strict=True))
    return Facts(name, type_name, source_id, "", 0.0, form, labels, units)


def facts_of_ours(
    topic: str,
    frame_id: str,
    raw_type: str,
    message: Any,
    *,
    is_latched: bool,
) -> Facts:
    """Return the facts about a stream that one of the node's stamped topics contains.

    Parameters
    ----------
    raw_type
        Type of the messages on the raw topic; empty if that was not recorded.
    message
        A ``Samples`` or ``Event``.

    Raises
    ------
    MessageError
        If it does not describe each channel of a stream.
    """
    data = topic.removesuffix(STAMPED).rpartition("/")[2]
    participant, _, sensor = frame_id.rpartition("/")
    try:
        message_type = MessageType(raw_type)
    except ValueError:
        message_type = None
    if not hasattr(message, "labels"):
        form, labels, units = ChannelFormat.STRING, ("event",), ("",)
        message_type = message_type or MessageType.STRING
    else:
        labels, units = tuple(message.labels), tuple(message.units)
        if not 0 < len(labels) == len(units) <= MAX_CHANNELS:
            text = (
                f"{len(labels)} labels and {len(units)} units do not describe the channels of a "
                "stream"
            )
            raise MessageError(text)
        form = ChannelFormat.INT64 if len(message.integers) else ChannelFormat.DOUBLE64
        form = _FORMATS.get(message_type, form) if message_type else form
        message_type = message_type or _GENERIC[form]
    identity = DeviceIdentity(sensor, "", participant)
    is_ours = is_data_name(sensor) and is_data_name(data)
    block = _block(identity, data, message_type, is_state=is_latched) if is_ours else {}
    return Facts(
        name=naming.lsl_name(identity, data) if is_ours else sensor,
        content_type=data,
        source_id=naming.source_id(identity, data) if is_ours else topic,
        host="",
        rate=0.0,
        format=form,
        labels=labels,
        units=units,
        block=tuple(block.items()),
    )


_GENERIC = {
    ChannelFormat.DOUBLE64: MessageType.FLOAT64_MULTI_ARRAY,
    ChannelFormat.INT64: MessageType.INT64_MULTI_ARRAY,
}


def listed_facts(statuses: Iterable[Any]) -> Mapping[str, Facts]:
    """Return the facts in the node's list of streams, by stamped topic."""
    found: dict[str, Facts] = {}
    for status in statuses:
        values = {pair.key: pair.value for pair in status.values}
        stamped = [key for key in values if key.startswith("topic ") and key.endswith(STAMPED)]
        try:
            facts = _listed(values, status.hardware_id, values.get(f"topic {status.name}", ""))
        except (KeyError, ValueError):
            continue
        found.update({key.removeprefix("topic "): facts for key in stamped})
    return found


def _listed(values: Mapping[str, str], unit: str, raw_type: str) -> Facts:
    source_id, form = values["source_id"], ChannelFormat(values["format"])
    labels, units = values["labels"].split(", "), values["units"].split(", ")
    if len(labels) != len(units):
        raise ValueError("there is not one unit per label")
    block: dict[str, str] = {}
    if values["foreign"] == "false":
        # The fields of a source_id contain none of these characters.
        of_device = re.split("[.-]", source_id.rpartition("@")[2])
        identity = DeviceIdentity(of_device[0], unit, values["participant"], values["label"])
        data, message_type = source_id.rpartition("-")[2], _message_type(raw_type, form, labels)
        block = _block(identity, data, message_type, is_state=False)
    return Facts(
        name=values["lsl_name"],
        content_type=values["lsl_type"],
        source_id=source_id,
        host=values["host"],
        rate=_rate(values["rate"]),
        format=form,
        labels=tuple(labels),
        units=tuple(units),
        block=tuple(block.items()),
    )


def _message_type(raw_type: str, form: ChannelFormat, labels: Sequence[str]) -> MessageType:
    """Return the message type of a stream, even if the node published another type."""
    known = {each.value for each in MessageType}
    if raw_type in known:
        return MessageType(raw_type)
    if form is not ChannelFormat.FLOAT32:
        raise ValueError(f"no {form} stream has messages of type {raw_type}")
    return MessageType.FLOAT32 if len(labels) == 1 else MessageType.FLOAT32_MULTI_ARRAY


def _rate(text: str) -> float:
    rate = float(text)
    if not 0 <= rate < math.inf:
        raise ValueError("it is not a rate")
    return rate


def _block(
    identity: DeviceIdentity, data: str, message_type: MessageType, *, is_state: bool
) -> dict[str, str]:
    return {
        "version": "1",
        "sensor": identity.sensor,
        "unit": identity.unit,
        "participant": identity.participant,
        "label": identity.label,
        "data_name": data,
        "category": Category.RAW.value,
        "message_type": message_type.value,
        "chunk": "",
        "is_state": str(is_state).lower(),
    }
