"""Records of an LSL stream's header, of a computed feature's source, and of a replay.

The block of a replay is below ``desc``, in addition to the unchanged recorded description::

    <replay>
      <file>study.xdf</file> <source_id>amplifier-1</source_id>
      <nominal_srate>130.0</nominal_srate> <speed>1.0</speed> <start>4711.25</start>
    </replay>

The stream's own source_id begins with :data:`PREFIX`, so that no receiver takes it for the
recorded stream. Blocks come from the network or a file and are not trusted.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass

from biosensor_common import naming
from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.known_senders import known_stream
from biosensor_common.quantities import Category, ChannelFormat, ChannelRole, MessageType
from biosensor_common.spec import DeviceIdentity

PREFIX = "replay:"
"""Prefix of the source_id of a replayed stream."""
_REPLAY = "desc/replay"
_MAX_CHARACTERS = 1024

STALE_AFTER_S = 5.0
"""Age of the newest sample after which there is no rate; some devices send in lumps of seconds."""
_SLOW_PERIODS = 3


def stale_after_s(nominal_hz: float) -> float:
    """Return the age in seconds at which the newest sample of a regular stream is outdated.

    Parameters
    ----------
    nominal_hz
        Its nominal rate, 0 if it has none; it is longer for slow streams.
    """
    return max(STALE_AFTER_S, _SLOW_PERIODS / nominal_hz) if nominal_hz > 0 else STALE_AFTER_S


@dataclass(frozen=True, slots=True)
class Replay:
    """The recording and the stream that are replayed, and how.

    Attributes
    ----------
    file
        Name of the recording, without its folder.
    source_id
        The recorded source_id; empty if there was none.
    rate
        Recorded nominal rate in Hz, 0 if irregular.
    speed
        Seconds of the recording per second.
    start_s
        Start of the replay in the recording: LSL time of the recording computer, in s.
    """

    file: str
    source_id: str
    rate: float
    speed: float
    start_s: float

    @property
    def title(self) -> str:
        """The file name, with the speed unless it is 1."""
        return self.file if self.speed == 1 else f"{self.file} at {self.speed:g} times its speed"


def replay_source_id(file_hash: str, recorded: str) -> str:
    """Return the source_id of a replayed stream, the same for each replay of a recording.

    Parameters
    ----------
    file_hash
        Hash of the recording's content.
    recorded
        Identifies the stream in the recording: its source_id.
    """
    return f"{PREFIX}{file_hash}:{recorded}"


def mark_as_replay(desc: ET.Element, replay: Replay) -> None:
    """Put the block into a ``desc`` element, replacing an existing one."""
    for old in desc.findall("replay"):
        desc.remove(old)
    block = ET.SubElement(desc, "replay")
    for name, text in (
        ("file", replay.file),
        ("source_id", replay.source_id),
        ("nominal_srate", repr(replay.rate)),
        ("speed", repr(replay.speed)),
        ("start", repr(replay.start_s)),
    ):
        ET.SubElement(block, name).text = text


def read_replay(root: ET.Element) -> Replay | None:
    """Parse the block of a stream's full description; None if there is none.

    Raises
    ------
    SpecError
        ``INVALID``, ``TOO_LARGE``, or ``MALFORMED`` for several blocks.
    """
    blocks = root.findall(_REPLAY)
    if not blocks:
        return None
    if len(blocks) > 1:
        raise SpecError(SpecReason.MALFORMED, "an LSL description has several <replay> blocks")
    text = {name: blocks[0].findtext(name) or "" for name in ("file", "source_id")}
    if any(len(each) > _MAX_CHARACTERS for each in text.values()):
        message = f"a name in a <replay> block is longer than {_MAX_CHARACTERS} characters"
        raise SpecError(SpecReason.TOO_LARGE, message)
    numbers = ("nominal_srate", "speed", "start")
    rate, speed, start_s = (_number(blocks[0], name) for name in numbers)
    if rate < 0 or speed <= 0:
        message = f"a <replay> block names {rate:g} Hz at {speed:g} times the speed"
        raise SpecError(SpecReason.INVALID, message)
    return Replay(text["file"], text["source_id"], rate, speed, start_s)


def recorded_source_id(source_id: str, replay: Replay | None) -> str:
    """Return the source_id that a stream had when it was measured, also for a replay."""
    return source_id if replay is None else replay.source_id


def _number(block: ET.Element, name: str) -> float:
    text = block.findtext(name) or ""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        message = (
            f"a <replay> block has {text[:_MAX_CHARACTERS]!r} as <{name}>, which is not a number"
        )
        raise SpecError(SpecReason.INVALID, message)
    return number


BLOCK = "features"
"""Element of ``desc`` that marks the stream of a computed feature."""
MAX_SOURCE_CHARACTERS = 512


@dataclass(frozen=True, slots=True)
class Derived:
    """Source of a computed feature, and how long its values are valid.

    Attributes
    ----------
    source_id
        source_id of the stream from which it was computed.
    holds_s
        Seconds after its stamp during which a value is valid.
    """

    source_id: str
    holds_s: float


def read_derived(root: ET.Element) -> Derived | None:
    """Parse a full description; None if it is not a feature or lacks these facts."""
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
    """The node's information about one stream.

    Units and content type are free text, because sensors that this version does not
    know may have others. Message types are a closed set.

    Attributes
    ----------
    labels, units
        One per channel, in channel order; empty if a foreign stream does not name them.
    roles
        One per channel; None for most channels and for foreign streams.
    rate
        Nominal rate in Hz, 0 if irregular.
    chunk
        Data name of the chunk topic, empty if there is none.
    is_state
        Whether each sample is valid until the next one; never for a regular or foreign stream.
    replay
        The recording of which it is a replay; None for a live stream.
    derived
        Source of a computed feature; None for a measured stream.
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
    """Map a foreign stream: the sensor is taken from its name, the data name from its type.

    Streams of a :mod:`known program <.known_senders>` get names, and missing labels and units,
    from a table. The array type follows the channel format, so that no precision is lost.
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
