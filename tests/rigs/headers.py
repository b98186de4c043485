"""Descriptions of streams as pylsl writes them."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree as ET

import pylsl

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity, FromDevice, StreamSpec
from biosensor_gateway.devices.registry import declaration, declaration_names


def declared_streams() -> list[tuple[str, StreamSpec]]:
    """Return every declared stream with its sensor; those of a device's own rate at 10 Hz."""
    streams = [
        (name, stream) for name in declaration_names() for stream in declaration(name).streams
    ]
    return [
        (name, replace(stream, rate=10.0) if isinstance(stream.rate, FromDevice) else stream)
        for name, stream in streams
    ]


def _append(parent: pylsl.XMLElement, element: ET.Element) -> None:
    for child in element:
        if len(child):
            _append(parent.append_child(child.tag), child)
        else:
            parent.append_child_value(child.tag, child.text or "")


def lsl_xml(stream: StreamSpec, identity: DeviceIdentity, desc: ET.Element) -> str:
    """Return a stream's description as pylsl writes it."""
    assert not isinstance(stream.rate, FromDevice)
    info = pylsl.StreamInfo(
        naming.lsl_name(identity, stream.data_name),
        stream.content_type.value,
        len(stream.channels),
        stream.rate,
        stream.format.value,
        naming.source_id(identity, stream.data_name),
    )
    _append(info.desc(), desc)
    return info.as_xml()
