"""The record of one LSL stream's header, and of what a feature was computed from."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass

from biosensor_common import naming
from biosensor_common.known_senders import known_stream
from biosensor_common.quantities import Category, ChannelFormat, ChannelRole, MessageType
from biosensor_common.replay import Replay
from biosensor_common.spec import DeviceIdentity

BLOCK = "features"
"""The element of ``desc`` that tells a stream of a feature from one that was measured."""
MAX_SOURCE_CHARACTERS = 512


@dataclass(frozen=True, slots=True)
class Derived:
    """Where a feature comes from, and how long a value of it is one of now.

    Attributes
    ----------
    source_id
        Of the stream that it was computed from.
    holds_s
        So many seconds after its stamp a value is not that of now any more.
    """

    source_id: str
    holds_s: float


def read_derived(root: ET.Element) -> Derived | None:
    """Read a full description; None if it tells of no feature, or of one without these facts."""
    block = root.find(f"desc/{BLOCK}")
    if block is None:
        return None
    source_id = block.findtext("source_id") or ""
    try:
        holds_s = float(block.findtext("holds_s") or "")
    except ValueError:
        return None
    is_usable = 0 < len(source_id) <= MAX_SOURCE_CHARACTERS and 0 < holds_s < math.inf
    return Derived(source_id, holds_s) if is_usable else None


MAX_FIELD_CHARACTERS = 128


@dataclass(frozen=True, slots=True)
class CoreFields:
    """The fields that every LSL stream has, with or without a description."""

    name: str
    content_type: str
    source_id: str
    hostname: str
    channel_count: int
    rate: float
    format: ChannelFormat

    def __str__(self) -> str:
        return f"LSL stream {self.name[:MAX_FIELD_CHARACTERS]!r}"


@dataclass(frozen=True, slots=True)
class StreamHeader:
    """What the node knows of one stream.

    Units and content type are free text here: a sensor that this version has
    never heard of brings its own. Message types are a closed set.

    Attributes
    ----------
    labels, units
        One a channel, in channel order; empty text where a foreign stream says nothing.
    roles
        One a channel, each in the unit of its role; None for most, and in a foreign stream.
    rate
        Nominal rate in Hz, 0 if irregular.
    chunk
        Data name of the chunk topic, empty if there is none.
    is_state
        Each sample holds until the next one; never of a regular or foreign stream.
    replay
        Of which recording it is played; None if it is measured now.
    derived
        What it was computed from; None if it was measured.
    """

    identity: DeviceIdentity
    data_name: str
    category: Category
    content_type: str
    labels: tuple[str, ...]
    units: tuple[str, ...]
    roles: tuple[ChannelRole | None, ...]
    rate: float
    format: ChannelFormat
    message_type: MessageType
    chunk: str
    is_state: bool = False
    foreign: bool = False
    replay: Replay | None = None
    derived: Derived | None = None


_GENERIC = {
    ChannelFormat.STRING: MessageType.STRING,
    ChannelFormat.DOUBLE64: MessageType.FLOAT64_MULTI_ARRAY,
    ChannelFormat.INT64: MessageType.INT64_MULTI_ARRAY,
    ChannelFormat.INT32: MessageType.INT32_MULTI_ARRAY,
    ChannelFormat.INT16: MessageType.INT32_MULTI_ARRAY,
    ChannelFormat.INT8: MessageType.INT32_MULTI_ARRAY,
}


def foreign_header(
    core: CoreFields,
    labels: tuple[str, ...] = (),
    units: tuple[str, ...] = (),
    replay: Replay | None = None,
) -> StreamHeader:
    """Map a stream that is not ours: sensor from its name, data name from its type.

    What a :mod:`known program <.known_senders>` sends has good names, and labels and units
    where it says none. No precision is lost: the array type follows the channel format.
    """
    blank = ("",) * core.channel_count
    labels, units = labels or blank, units or blank
    said = core.name, core.content_type, core.source_id, core.hostname
    identity, data_name = naming.foreign_identity(*said)
    known = known_stream(*said)
    if known is not None:
        labels = known[0].labelled(labels)
        units = known[0].with_units(labels, units)
    has_chunks = core.rate > 0 and core.format is not ChannelFormat.STRING
    return StreamHeader(
        identity=identity,
        data_name=data_name,
        category=Category.RAW,
        content_type=core.content_type,
        labels=labels,
        units=units,
        roles=(None,) * core.channel_count,
        rate=core.rate,
        format=core.format,
        message_type=_GENERIC.get(core.format, MessageType.FLOAT32_MULTI_ARRAY),
        chunk=data_name if has_chunks else "",
        foreign=True,
        replay=replay,
    )
