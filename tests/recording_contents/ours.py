"""The description that our streams carry."""

from __future__ import annotations

from xml.etree import ElementTree as ET


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
