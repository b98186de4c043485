"""What a header says of its channels and its stream counts; what it leaves unsaid is no guess."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import pylsl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.lsl_header import append_children, describe, read_header
from biosensor_common.quantities import ACCELERATION, MAGNETIC_FIELD, ORIENTATION, ChannelRole
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_common.stream_header import MAX_FIELD_CHARACTERS, StreamHeader
from tests.rigs.headers import declared_streams, lsl_xml

INFO = DeviceInfo("maker", "model", "serial", "1.2")
BATTERY, MOTION = "zephyr.bat", "emotiv_insight.mot"
ROLE, STATE = "<role>state_of_charge</role>", "<is_state>true</is_state>"


def headers() -> dict[str, str]:
    """What the agent writes for each stream."""
    written: dict[str, str] = {}
    for name, stream in declared_streams():
        identity = DeviceIdentity(name, "U1", participant="p01", label="left")
        written[f"{name}.{stream.data_name}"] = lsl_xml(
            stream, identity, describe(stream, identity, INFO)
        )
    return written


def altered(name: str, *changes: tuple[str, str]) -> StreamHeader:
    xml = headers()[name]
    for old, new in changes:
        assert old in xml
        xml = xml.replace(old, new)
    return read_header(xml)


def test_a_component_in_another_unit_has_no_role() -> None:
    motion = altered(MOTION, ("<unit>g<", "<unit>m/s^2<"))
    assert set(motion.roles) == {None, *ORIENTATION, *MAGNETIC_FIELD}
    assert set(altered(MOTION).roles) == {*ORIENTATION, *ACCELERATION, *MAGNETIC_FIELD}


def test_channels_that_do_not_fit_the_stream_have_no_roles() -> None:
    roles = altered(MOTION, ("<channels>", "<channels><channel/>")).roles
    assert roles == (None,) * len(roles)


@pytest.mark.parametrize(
    ("changes", "role", "is_state"),
    [
        ((), ChannelRole.STATE_OF_CHARGE, True),
        (((ROLE, ""),), None, True),
        (((STATE, ""),), ChannelRole.STATE_OF_CHARGE, False),
        (((ROLE, ""), (STATE, "")), None, False),
        (((ROLE, ""), (STATE, "<is_state>false</is_state>")), None, False),
    ],
)
def test_both_elements_are_optional_and_nothing_is_inferred(
    changes: tuple[tuple[str, str], ...], role: ChannelRole | None, is_state: bool
) -> None:
    header = altered(BATTERY, *changes)
    assert (header.foreign, header.roles, header.is_state) == (False, (role,), is_state)


@pytest.mark.parametrize(
    "role",
    ["blood_pressure", "STATE_OF_CHARGE", " state_of_charge", "contact", "r" * 5000, "&#233;", ""],
)
def test_a_role_of_a_later_version_or_in_another_unit_is_ignored(role: str) -> None:
    header = altered(BATTERY, (">state_of_charge<", f">{role}<"))
    assert (header.foreign, header.roles, header.is_state) == (False, (None,), True)
    assert header.labels == ("level",)


@pytest.mark.parametrize(
    ("name", "old", "new", "reason"),
    [
        (BATTERY, ">true<", "><", SpecReason.INVALID),
        (BATTERY, ">true<", ">True<", SpecReason.INVALID),
        (BATTERY, ">true<", ">1<", SpecReason.INVALID),
        (BATTERY, ">true<", f">{'t' * (MAX_FIELD_CHARACTERS + 1)}<", SpecReason.TOO_LARGE),
        (BATTERY, "<is_state>", "<is_state>true</is_state><is_state>", SpecReason.MALFORMED),
        ("zephyr.ecg", "<is_state>false", "<is_state>true", SpecReason.CONTRADICTORY),
    ],
)
def test_a_false_claim_to_be_a_state_is_refused_in_one_sentence(
    name: str, old: str, new: str, reason: SpecReason
) -> None:
    with pytest.raises(SpecError) as refused:
        altered(name, (old, new))
    assert refused.value.reason is reason
    assert "state" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_roles_of_another_programs_stream_are_not_believed() -> None:
    root = ET.fromstring(headers()[BATTERY])
    desc, block = root.find("desc"), root.find("desc/biosensor")
    assert desc is not None
    assert block is not None
    desc.remove(block)
    header = read_header(ET.tostring(root, encoding="unicode"))
    assert (header.foreign, header.roles, header.is_state) == (True, (None,), False)


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
