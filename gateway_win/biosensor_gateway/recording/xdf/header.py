"""Reads the XML of a recording: the headers of its streams, and their footers."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from html import escape, unescape

from biosensor_common.errors import SpecError
from biosensor_common.lsl_header import MAX_CHANNELS, read_channels, read_header, read_xml
from biosensor_common.naming import AGENT, NODE
from biosensor_common.quantities import ChannelFormat, waits_for_receivers
from biosensor_common.ros_clock import KEY, ClockPair, read_clock_pair
from biosensor_common.spec import DeviceIdentity
from biosensor_common.stream_header import BLOCK, Replay, StreamHeader
from biosensor_gateway.recording.xdf.container import ChunkError

MAX_XML_CHARACTERS = 64_000_000
# No device samples faster, so a higher rate means a damaged header.
_MAX_RATE_HZ = 1e9
# Senders call them Markers, markers, Marker, StringMarker, LSL_Marker_Strings, Trigger, Events.
_MARKERS = ("marker", "trigger", "event", "stim")


@dataclass(frozen=True, slots=True)
class RobotTopic:
    """The description of the topic in the header of a stream from ``ros_to_lsl``."""

    topic: str
    # Origin of the first sample's timestamp: the message's header, its source, or its arrival.
    stamped_by: str
    clock: str  # What was known about the clock of the timestamps; one word.
    edge_s: float  # How far that clock may be behind, or is ahead if negative; NaN if not given.


@dataclass(frozen=True, slots=True)
class RecordedHeader:
    """The header of one recorded stream."""

    name: str
    content_type: str
    source_id: str
    hostname: str
    channel_count: int
    format: ChannelFormat
    rate: float  # Nominal rate in Hz, 0 if irregular.
    created_at: float  # LSL time at which the outlet was made, on its host's clock; NaN if unknown.
    # labels, units: one per channel; a number and an empty text where the header gives none.
    labels: tuple[str, ...]
    units: tuple[str, ...]
    # Whether samples may be missing, so that loaders must not smooth the timestamps.
    can_drop_samples: bool
    # identity, data_name: identifies one of our streams; None and empty for another program's
    # stream.
    identity: DeviceIdentity | None
    data_name: str
    # Why a `<biosensor>` block was rejected; empty if there was none or it was accepted.
    refused: str
    # The recording that was replayed; None for a stream that was recorded live.
    replay: Replay | None = None
    # The topic that `ros_to_lsl` turned into the stream; None for other streams.
    robot: RobotTopic | None = None
    xml: str = ""
    # Whether its samples may have been measured long before the recording began.
    may_be_older: bool = False
    is_guessed: bool = False  # Whether its text is not UTF-8, so the encoding was guessed.
    # Longest time window of a feature's values; None for measured streams.
    window_s: float | None = None

    @property
    def title(self) -> str:
        """The stream's name for sentences, or ``nameless`` and its kind."""
        return self.name if self.name.strip() else f"nameless {self.content_type or 'stream'}"

    def lacks(self, footer: Footer | None, sample_count: int) -> bool:
        """Whether the recorder should have written a footer, and has not."""
        return footer is None and (self.is_recordable or sample_count > 0)

    @property
    def is_ours(self) -> bool:
        """Whether the capture agent made the stream."""
        return self.identity is not None

    @property
    def is_of_agent(self) -> bool:
        """Whether a capture agent sent it live, and so counted its samples."""
        return self.is_ours and self.replay is None and not self._is_from(NODE)

    @property
    def is_counters(self) -> bool:
        """Whether it is the capture agent's stream of sample counts."""
        return self._is_from(AGENT, "counters")

    @property
    def is_events(self) -> bool:
        """Whether it is the capture agent's stream of device events."""
        return self._is_from(AGENT, "events")

    @property
    def is_events_of_node(self) -> bool:
        """Whether it is a node's stream of events about the topics that it sends."""
        return self._is_from(NODE, "events")

    @property
    def is_recordable(self) -> bool:
        """Whether LabRecorder writes its samples and its footer."""
        return self.format is not ChannelFormat.INT64

    @property
    def is_regular(self) -> bool:
        """Whether it has a nominal sample rate."""
        return self.rate > 0

    @property
    def has_exact_stamps(self) -> bool:
        """Whether each timestamp is exact: in our streams, and where samples may be missing."""
        return self.is_ours or self.can_drop_samples

    @property
    def is_markers(self) -> bool:
        """Whether the stream has events rather than measurements.

        That is text of any type, and numbers without a rate whose type mentions markers.
        """
        if self.format is ChannelFormat.STRING:
            return True
        kind = self.content_type.lower()
        return not self.is_regular and any(word in kind for word in _MARKERS)

    def _is_from(self, program: str, data_name: str = "") -> bool:
        is_from = self.identity is not None and self.identity.sensor == program
        return is_from and data_name in {"", self.data_name} and self.replay is None

    def parsed(self) -> ET.Element:
        """Return the header as XML elements.

        Raises
        ------
        SpecError
            ``MALFORMED`` if it is not XML.
        """
        return read_xml(self.xml, MAX_XML_CHARACTERS)


@dataclass(frozen=True, slots=True)
class Footer:
    """The footer of one recorded stream; missing fields are None."""

    sample_count: int | None


@dataclass(frozen=True, slots=True)
class FileClock:
    """How the file's clock relates to Unix time."""

    resolution_s: float  # How far off a pair may be.
    pairs: tuple[ClockPair, ...]  # Moments on both clocks, ascending, at least one.


def decoded(content: bytes | memoryview) -> tuple[str, bool]:
    """Return a text, and whether its encoding was guessed because it is not UTF-8.

    Programs on Windows often send text in the computer's code page. Text that contains some valid
    UTF-8 characters outside ASCII is taken as damaged UTF-8.
    """
    try:
        return str(content, "utf-8"), False
    except UnicodeDecodeError:
        text = str(content, "utf-8", "replace")
    if all(char.isascii() or char == _REPLACED for char in text):
        try:
            text = str(content, "cp1252")
        except UnicodeDecodeError:
            text = str(content, "latin-1")
    return text, True


_REPLACED = "\N{REPLACEMENT CHARACTER}"


def parse_stream_header(content: bytes) -> RecordedHeader:
    """Decode the content of a stream header chunk, without the stream's number.

    Raises
    ------
    ChunkError
        If it is not XML, or without it the samples cannot be decoded.
    """
    root, text = _parse(content)
    channel_count, rate = _number(root, "channel_count"), _number(root, "nominal_srate")
    if not 0 < channel_count <= MAX_CHANNELS or channel_count != int(channel_count):
        raise ChunkError("it has no usable number of channels")
    if not 0 <= rate < _MAX_RATE_HZ:
        raise ChunkError("it has no usable nominal rate")
    try:
        channel_format = ChannelFormat(root.findtext("channel_format") or "")
    except ValueError:
        raise ChunkError("it has no known channel format") from None
    own, refused = _own(text)
    ours = None if own is None or own.foreign else own
    drops = root.findtext("desc/synchronization/can_drop_samples") or ""
    return RecordedHeader(
        name=root.findtext("name") or "",
        content_type=root.findtext("type") or "",
        source_id=root.findtext("source_id") or "",
        hostname=root.findtext("hostname") or "",
        channel_count=int(channel_count),
        format=channel_format,
        rate=rate,
        created_at=_number(root, "created_at"),
        labels=_labels(root, int(channel_count)),
        units=read_channels(root, int(channel_count)).units,
        can_drop_samples=drops.strip().lower() == "true",
        identity=ours.identity if ours else None,
        data_name=ours.data_name if ours else "",
        refused=refused,
        replay=own.replay if own else None,
        robot=_robot(root),
        xml=text,
        is_guessed=decoded(content)[1],
        window_s=_window_s(root) if ours else None,
        may_be_older=ours is not None
        and waits_for_receivers(ours.content_type, is_regular=rate > 0, is_state=ours.is_state),
    )


def fix_stream_header(content: bytes) -> tuple[bytes, tuple[str, ...]]:
    """Return the corrected content of a stream header chunk, and what was wrong with it.

    Fixes the errors that some programs make: control characters (such as the end of a C string), a
    bare ``&``, a document type, entities of HTML, namespaces, spaces around fields, a decimal
    comma, a unit, ``cf_float32``, UTF-16, no nominal rate or an impossible one, no number of
    channels.

    Raises
    ------
    ChunkError
        If the corrected content cannot be read either.
    """
    text, _ = decoded(content)
    wrong: list[str] = []
    if content[1:2] == b"\0" or content.startswith(_UTF16):
        text = str(content, "utf-16" if content.startswith(_UTF16) else "utf-16-le", "replace")
        wrong.append("UTF-16 instead of UTF-8")
    for pattern, instead, what in _FIXES:
        text, count = pattern.subn(instead, text)
        wrong += [what] if count else []
    text = text.strip()
    root, _ = _parse(text.encode())
    for name, fix in _FIXED_FIELDS.items():
        node = root.find(name)
        before = "" if node is None else node.text or ""
        after = fix(before.strip(), root)
        if after != before:
            node = ET.SubElement(root, name) if node is None else node
            node.text = after
            wrong.append(f"{name} {before!r}" if before else f"no {name}")
    if not wrong:
        raise ChunkError("none of it can be fixed")
    return ET.tostring(root, encoding="utf-8"), tuple(wrong)


_UTF16 = (b"\xff\xfe", b"\xfe\xff")


def _escaped(section: re.Match[str]) -> str:
    return escape(section[1])


def _known(entity: re.Match[str]) -> str:
    """Return the character of an entity of HTML; any other one as the text that it is."""
    character = unescape(entity[0])
    return character if character != entity[0] else f"&amp;{entity[0][1:]}"


def _without_namespaces(tag: re.Match[str]) -> str:
    bare = re.sub(r"""\sxmlns(:[\w.-]+)?\s*=\s*("[^"]*"|'[^']*')""", "", tag[0])
    return re.sub(r"(</?|\s)[\w.-]+:(?=[\w.-]+[\s=/>])", r"\1", bare)


_FIXES: tuple[tuple[re.Pattern[str], str | Callable[[re.Match[str]], str], str], ...] = (
    # So that the following ones see its text as that of any other field.
    (re.compile(r"<!\[CDATA\[(.*?)\]\]>", re.DOTALL), _escaped, "a CDATA section"),
    (re.compile(r"<!DOCTYPE[^>\[]*(\[[^\]]*\])?[^>]*>"), "", "a document type"),
    (re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]"), "", "control characters"),
    (re.compile(r"&(?!(?:\w{1,10}|#\d{1,7}|#x[0-9a-fA-F]{1,6});)"), "&amp;", "a bare &"),
    (re.compile(r"&(?!amp;|lt;|gt;|quot;|apos;)\w+;"), _known, "entities that XML does not know"),
    (
        re.compile(r"<(?=/?[\w.-]+:|[^<>]*\s[\w.-]+:[\w.-]+\s*=|[^<>]*\sxmlns\s*=)[^<>]*>"),
        _without_namespaces,
        "XML namespaces",
    ),
)


def _fixed_count(text: str, root: ET.Element) -> str:
    described = len(root.findall("desc/channels/channel"))
    return str(described) if described and text in {"", "0"} else text.replace(",", ".")


def _fixed_rate(text: str, _root: ET.Element) -> str:
    number = text.replace(",", ".").lower().removesuffix("hz").rstrip()
    try:
        return number if 0 <= float(number) < _MAX_RATE_HZ else "0"
    except ValueError:
        return "0"


# What other languages call the formats.
_FORMATS = {"float64": "double64", "double": "double64", "float": "float32", "str": "string"}


def _fixed_format(text: str, _root: ET.Element) -> str:
    name = text.removeprefix("cf_").lower()
    return _FORMATS.get(name, name)


_FIXED_FIELDS: Mapping[str, Callable[[str, ET.Element], str]] = {
    "channel_count": _fixed_count,
    "nominal_srate": _fixed_rate,
    "channel_format": _fixed_format,
}


def parse_footer(content: bytes) -> Footer:
    """Decode the content of a stream footer chunk, without the stream's number.

    Raises
    ------
    ChunkError
        If it is not XML.
    """
    root, _ = _parse(content)
    count = _number(root, "sample_count")
    return Footer(int(count) if math.isfinite(count) else None)


def parse_file_header(content: bytes) -> str:
    """Return the recorder's text for the start time of the recording; empty if there is none.

    Raises
    ------
    ChunkError
        If it is not XML.
    """
    root, _ = _parse(content)
    return root.findtext("datetime") or ""


def parse_file_clock(content: bytes) -> FileClock | None:
    """Return the relation of the file's clock to Unix time; None if the header has none.

    Raises
    ------
    ChunkError
        If it is not XML.
    """
    root, _ = _parse(content)
    pairs: list[ClockPair] = []
    for node in root.findall("clock"):
        try:
            told = {"lsl_s": float(node.findtext("lsl_s") or ""), "unix_ns": _whole(node)}
        except ValueError:
            return None
        pair = read_clock_pair({KEY: told})
        if pair is None or (pairs and pair.lsl_s < pairs[-1].lsl_s):
            return None
        pairs.append(pair)
    resolution_s = _number(root, "clock/resolution_s")
    if not pairs or not 0 <= resolution_s < math.inf:
        return None
    return FileClock(resolution_s, tuple(pairs))


def _whole(node: ET.Element) -> int:
    return int(node.findtext("unix_ns") or "")


def _parse(content: bytes) -> tuple[ET.Element, str]:
    text, _ = decoded(content)
    try:
        return read_xml(text, MAX_XML_CHARACTERS), text
    except SpecError as error:
        raise ChunkError(str(error)) from error


def _number(root: ET.Element, field: str) -> float:
    try:
        return float(root.findtext(field) or "")
    except ValueError:
        return math.nan


def _labels(root: ET.Element, count: int) -> tuple[str, ...]:
    nodes = root.findall("desc/channels/channel")
    labels = [node.findtext("label") or "" for node in nodes]
    complete = labels if len(labels) == count else [""] * count
    return tuple(label or str(index + 1) for index, label in enumerate(complete))


def _window_s(root: ET.Element) -> float | None:
    block = root.find(f"desc/{BLOCK}")
    return None if block is None else _number(block, "window_s")


def _robot(root: ET.Element) -> RobotTopic | None:
    block = root.find("desc/ros")
    if block is None or not block.findtext("topic"):
        return None
    topic, stamped_by, clock = (block.findtext(n) or "" for n in ("topic", "stamp_source", "clock"))
    return RobotTopic(topic, stamped_by, clock, _number(block, "clock_edge_s"))


def _own(xml: str) -> tuple[StreamHeader | None, str]:
    """Return our own part of the header, or why it was rejected."""
    try:
        return read_header(xml), ""
    except SpecError as error:
        return None, str(error)
