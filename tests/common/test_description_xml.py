"""Any text in a description leaves a header that programs can read."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import pylsl
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.description_xml import append_children

# pylsl gives UTF-8, which has no surrogates.
texts = st.text(st.characters(exclude_categories=("Cs",)))


def as_read(text: str) -> str:
    """Return the text as another program reads it from LSL's own XML."""
    description = ET.Element("desc")
    ET.SubElement(description, "label").text = text
    info = pylsl.StreamInfo("a", "b", 1, 0.0, "float32", "c")
    append_children(info.desc(), description)
    return ET.fromstring(info.as_xml()).findtext("desc/label") or ""


@given(text=texts)
def test_every_text_can_be_read_again(text: str) -> None:
    assert len(as_read(text)) in (len(text), len(text.replace("\r\n", "\n")))


def test_only_what_xml_cannot_hold_is_replaced() -> None:
    assert as_read("a\x01b\x00c\ufffe") == "a\ufffdb\ufffdc\ufffd"
    assert as_read("\u00e4 <\u4e16> & \U0001f600\t.") == "\u00e4 <\u4e16> & \U0001f600\t."
