"""Headers of our own streams, by their declarations."""

from __future__ import annotations

from xml.etree import ElementTree as ET

from biosensor_common.lsl_header import describe
from biosensor_common.naming import lsl_name, source_id
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from tests.xdf import xdf_file as x


def own_header(stream_id: int, identity: DeviceIdentity, data_name: str) -> bytes:
    """Return the header chunk of a stream with a fixed rate, or none."""
    spec = declaration(identity.sensor).stream(data_name)
    assert isinstance(spec.rate, int | float)
    return x.stream_header(
        stream_id,
        lsl_name(identity, data_name),
        kind=spec.content_type.value,
        channels=len(spec.channels),
        rate=float(spec.rate),
        fmt=spec.format.value,
        source_id=source_id(identity, data_name),
        desc=describe(spec, identity, DeviceInfo()),
    )


# The description that our streams carry.


def description(sensor: str, data_name: str, participant: str = "") -> ET.Element:
    """Return the ``desc`` of a stream of the unit ``u1``; of text if it is called events."""
    is_text = data_name == "events"
    desc = ET.Element("desc")
    block = ET.SubElement(desc, "biosensor")
    for name, text in {
        "version": "1",
        "sensor": sensor,
        "unit": "u1",
        "participant": participant,
        "label": "",
        "data_name": data_name,
        "category": "raw",
        "message_type": "std_msgs/msg/" + ("String" if is_text else "Float32MultiArray"),
        "chunk": "" if is_text else data_name,
        "is_state": "false",
    }.items():
        ET.SubElement(block, name).text = text
    return desc
