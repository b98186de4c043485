"""Writes and reads a stream's declaration and its channels as LSL description XML.

In addition to the XDF fields that LabRecorder users, MNE-LSL and EEGLAB read, the
description has one versioned block, from which any node can map the stream even if
it does not know the sensor::

    <biosensor>
      <version>1</version> <sensor>zephyr</sensor> <unit>BHT012345</unit>
      <participant/> <label/> <data_name>ecg</data_name> <category>raw</category>
      <message_type>std_msgs/msg/Float32</message_type> <chunk>ecg</chunk>
      <is_state>false</is_state>
    </biosensor>

A channel whose meaning matters to agent or node has a ``<role>`` in addition to its
label and unit. Both ``<role>`` and ``<is_state>`` are optional: without the first, the
channel has no special meaning; without the second, the stream is not a state.

Descriptions come from the network and are not trusted: their size is limited, names
are checked, and a block that contradicts its stream is refused as a whole. Unknown
elements are ignored, and so are roles that are unknown or have another unit.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol, Self, TypeVar
from xml.etree.ElementTree import Element, ParseError, fromstring

from biosensor_common import naming
from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.quantities import (
    Category,
    ChannelFormat,
    ChannelRole,
    ContentType,
    MessageType,
)
from biosensor_common.spec import DeviceIdentity, DeviceInfo, StreamSpec, is_data_name
from biosensor_common.stream_header import (
    MAX_FIELD_CHARACTERS,
    CoreFields,
    Replay,
    StreamHeader,
    foreign_header,
    read_derived,
    read_replay,
    recorded_source_id,
)

# Characters that XML 1.0 forbids (https://www.w3.org/TR/xml/#charsets). liblsl writes them anyway,
# and then no program can parse the header, and pyxdf cannot load the recording.
_NO_XML = re.compile("[^\t\n\r\\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class XmlNode(Protocol):
    """The methods of ``pylsl.XMLElement`` that are used here."""

    def append_child(self, name: str, /) -> Self:
        """Append an element and return it."""
        ...

    def append_child_value(self, name: str, value: str, /) -> Self:
        """Append an element with a text."""
        ...


def append_children(parent: XmlNode, element: Element) -> None:
    """Append the children of an element, without attributes and mixed text.

    Characters that XML forbids, such as most control characters, become U+FFFD.
    """
    for child in element:
        if len(child):
            append_children(parent.append_child(child.tag), child)
        else:
            parent.append_child_value(child.tag, xml_text(child.text or ""))


def xml_text(text: str) -> str:
    """Return a text with U+FFFD in place of characters that XML forbids."""
    return _NO_XML.sub("\N{REPLACEMENT CHARACTER}", text)


def read_xml(xml: str, most_characters: int) -> Element:
    """Parse XML from an untrusted source.

    Raises
    ------
    SpecError
        ``TOO_LARGE``; ``MALFORMED``, also if there is a document type.
    """
    if len(xml) > most_characters:
        message = f"the XML has {len(xml)} characters, more than {most_characters}"
        raise SpecError(SpecReason.TOO_LARGE, message)
    if "<!" in xml.replace("<!--", "").replace("<![CDATA[", ""):
        # XML parsers are attacked by document types and entities, and no stream needs them.
        raise SpecError(SpecReason.MALFORMED, "the XML has a document type")
    try:
        return fromstring(xml)  # noqa: S314 - no document type, limited in size
    except (ParseError, ValueError) as error:
        # ValueError: a lone surrogate cannot be encoded as UTF-8.
        raise SpecError(SpecReason.MALFORMED, f"the XML is not well-formed ({error})") from error


class Channels(NamedTuple):
    """The description of the channels, in channel order.

    Attributes
    ----------
    labels, units
        Empty text where there is none.
    roles
        None where there is none, an unknown one, or one with another unit.
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    roles: tuple[ChannelRole | None, ...]


def read_channels(root: ET.Element, count: int) -> Channels:
    """Return the channels; empty fields if the description has another number of them."""
    nodes = root.findall("desc/channels/channel")
    if len(nodes) != count:
        blank = ("",) * count
        return Channels(blank, blank, (None,) * count)
    units = _texts(nodes, "unit")
    pairs = zip(_texts(nodes, "role"), units, strict=True)
    roles = tuple(_role(text, unit) for text, unit in pairs)
    return Channels(_texts(nodes, "label"), units, roles)


def _texts(nodes: Sequence[ET.Element], field: str) -> tuple[str, ...]:
    return tuple((node.findtext(field) or "")[:MAX_FIELD_CHARACTERS] for node in nodes)


def _role(text: str, unit: str) -> ChannelRole | None:
    try:
        role = ChannelRole(text)
    except ValueError:
        # No role, or one of a later version.
        return None
    return role if role.unit == unit else None


VERSION = "1"
MAX_XML_CHARACTERS = 1_000_000
MAX_CHANNELS = 4096
_E = TypeVar("_E", Category, MessageType)
# Channel types of the XDF wiki, where they differ from the stream's type.
_CHANNEL_TYPES = {ContentType.RESPIRATION: "RESP", ContentType.TEMPERATURE: "TEMPERATURE"}


def describe(stream: StreamSpec, identity: DeviceIdentity, info: DeviceInfo) -> ET.Element:
    """Build the ``desc`` element of a stream."""
    desc = ET.Element("desc")
    channels = ET.SubElement(desc, "channels")
    for channel in stream.channels:
        node = ET.SubElement(channels, "channel")
        kind = _CHANNEL_TYPES.get(stream.content_type, stream.content_type.value)
        _append(node, label=channel.label, unit=str(channel.unit), type=kind)
        if channel.role is not None:
            _append(node, role=channel.role.value)
        if channel.scale is not None:
            scale = channel.scale
            _append(
                ET.SubElement(node, "nominal_scale"),
                factor=repr(scale.factor),
                unit=str(scale.unit),
                zero=repr(scale.zero),
            )
    _append(
        ET.SubElement(desc, "acquisition"),
        manufacturer=info.manufacturer,
        model=info.model,
        serial_number=info.serial_number,
        firmware_version=info.firmware_version,
    )
    synchronization = ET.SubElement(desc, "synchronization")
    _append(synchronization, offset_mean="0")
    if stream.is_regular:
        # Without this flag pyxdf spreads a gap of less than 500 samples over the whole recording.
        _append(synchronization, can_drop_samples="true")
    _append(
        ET.SubElement(desc, "biosensor"),
        version=VERSION,
        sensor=identity.sensor,
        unit=identity.unit,
        participant=identity.participant,
        label=identity.label,
        data_name=stream.data_name,
        category=stream.category.value,
        message_type=stream.message_type.value,
        chunk=stream.chunk,
        is_state=str(stream.is_state).lower(),
    )
    return desc


def _append(parent: ET.Element, **fields: str) -> None:
    for name, text in fields.items():
        ET.SubElement(parent, name).text = text


def read_header(xml: str) -> StreamHeader:
    """Read the full description of a stream, as ``pylsl.StreamInfo.as_xml`` gives it.

    A stream without a block gets the generic mapping of :func:`.foreign_header`.

    Raises
    ------
    SpecError
        ``TOO_LARGE``, ``MALFORMED``, ``UNKNOWN_VERSION``, ``INVALID`` or
        ``CONTRADICTORY``; the stream can still be mapped by :func:`.foreign_header`.
    """
    root = read_xml(xml, MAX_XML_CHARACTERS)
    core = _core(root)
    blocks = root.findall("desc/biosensor")
    if not blocks:
        channels = read_channels(root, core.channel_count)
        return foreign_header(core, channels.labels, channels.units, read_replay(root))
    if len(blocks) > 1:
        raise SpecError(SpecReason.MALFORMED, f"{core}: more than one <biosensor> block")
    own = _own(core, blocks[0], read_channels(root, core.channel_count), read_replay(root))
    return replace(own, derived=read_derived(root))


_CORE_FIELDS = (
    "name",
    "type",
    "source_id",
    "hostname",
    "channel_count",
    "nominal_srate",
    "channel_format",
)


def _core(root: ET.Element) -> CoreFields:
    text = {field: root.findtext(field) or "" for field in _CORE_FIELDS}
    stream = f"LSL stream {text['name'][:MAX_FIELD_CHARACTERS]!r}"
    try:
        count, rate = int(text["channel_count"]), float(text["nominal_srate"])
        channel_format = ChannelFormat(text["channel_format"])
    except ValueError as error:
        message = f"{stream}: its core fields cannot be read ({error})"
        raise SpecError(SpecReason.MALFORMED, message) from error
    if not 0 < count <= MAX_CHANNELS or not 0 <= rate < math.inf:
        message = f"{stream}: {count} channels at {rate} Hz are not usable"
        raise SpecError(SpecReason.INVALID, message)
    return CoreFields(
        name=text["name"],
        content_type=text["type"],
        source_id=text["source_id"],
        hostname=text["hostname"],
        channel_count=count,
        rate=rate,
        format=channel_format,
    )


def _own(
    core: CoreFields, block: ET.Element, channels: Channels, replay: Replay | None
) -> StreamHeader:
    version = _field(core, block, "version")
    if version != VERSION:
        message = f"{core}: <biosensor> version {version!r} is newer than this node; update it"
        raise SpecError(SpecReason.UNKNOWN_VERSION, message)
    identity = DeviceIdentity(
        sensor=_field(core, block, "sensor"),
        unit=_field(core, block, "unit"),
        participant=_field(core, block, "participant"),
        label=_field(core, block, "label"),
    )
    data_name = _field(core, block, "data_name")
    header = StreamHeader(
        identity=identity,
        data_name=data_name,
        category=_member(core, Category, _field(core, block, "category")),
        content_type=core.content_type,
        labels=channels.labels,
        units=channels.units,
        roles=channels.roles,
        rate=core.rate,
        format=core.format,
        message_type=_member(core, MessageType, _field(core, block, "message_type")),
        chunk=_field(core, block, "chunk"),
        is_state=_is_state(core, block),
        replay=replay,
    )
    _check(core, header)
    return header


def _is_state(core: CoreFields, block: ET.Element) -> bool:
    if block.find("is_state") is None:
        return False
    text = _field(core, block, "is_state")
    if text not in ("true", "false"):
        message = f"{core}: <is_state> is {text!r} instead of 'true' or 'false'"
        raise SpecError(SpecReason.INVALID, message)
    return text == "true"


def _field(core: CoreFields, block: ET.Element, name: str) -> str:
    found = block.findall(name)
    if len(found) != 1:
        message = f"{core}: <biosensor> has {len(found)} elements <{name}> instead of one"
        raise SpecError(SpecReason.MALFORMED, message)
    text = found[0].text or ""
    if len(text) > MAX_FIELD_CHARACTERS:
        message = f"{core}: <{name}> is longer than {MAX_FIELD_CHARACTERS} characters"
        raise SpecError(SpecReason.TOO_LARGE, message)
    return text


def _member(core: CoreFields, kind: type[_E], text: str) -> _E:
    try:
        return kind(text)
    except ValueError as error:
        message = f"{core}: {text!r} is not a known {kind.__name__}"
        raise SpecError(SpecReason.INVALID, message) from error


def _check(core: CoreFields, header: StreamHeader) -> None:
    """Refuse a block that has invalid names or contradicts its stream."""
    identity, message_type = header.identity, header.message_type
    names = (identity.sensor, header.data_name, header.chunk or "ok")
    if not all(is_data_name(name) for name in names):
        raise SpecError(SpecReason.INVALID, f"{core}: {names} are not all lower-case ROS names")
    is_text = header.format is ChannelFormat.STRING
    measured_as = recorded_source_id(core.source_id, header.replay)
    for lie, claim in (
        (measured_as != naming.source_id(identity, header.data_name), "another source_id"),
        (is_text != message_type.is_text, f"messages {message_type}"),
        (core.channel_count > 1 and not message_type.is_array, f"messages {message_type}"),
        (_is_too_narrow(message_type, header.format), f"messages {message_type}"),
        (bool(header.chunk) and (is_text or core.rate == 0), "chunks"),
        (header.is_state and core.rate > 0, "to be a state"),
    ):
        if lie:
            message = f"{core}: its <biosensor> block claims {claim}, which does not fit the stream"
            raise SpecError(SpecReason.CONTRADICTORY, message)


def _is_too_narrow(message_type: MessageType, channel_format: ChannelFormat) -> bool:
    """Whether an integer array type cannot hold all values of a format."""
    if message_type is MessageType.INT64_MULTI_ARRAY:
        return channel_format.is_float
    is_int32 = message_type is MessageType.INT32_MULTI_ARRAY
    return is_int32 and (channel_format.is_float or channel_format is ChannelFormat.INT64)
