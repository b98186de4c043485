"""Descriptions survive LSL unchanged, and whatever comes from a network is read safely."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from xml.etree import ElementTree as ET

import pylsl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biosensor_common import naming
from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.lsl_header import MAX_XML_CHARACTERS, describe, read_header
from biosensor_common.quantities import ChannelFormat, MessageType
from biosensor_common.spec import DeviceIdentity, DeviceInfo, StreamSpec
from biosensor_common.stream_header import MAX_FIELD_CHARACTERS
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet
from tests.rigs.headers import declared_streams, lsl_xml

INFO = DeviceInfo("maker", "model", "serial <1> & 'so' on", "1.2")
IDENTITY = DeviceIdentity("zephyr", "BH1", participant="p01", label="left")
DEADLINE_S = 30.0


def own_xml() -> str:
    stream = declaration("zephyr").stream("ecg")
    return lsl_xml(stream, IDENTITY, describe(stream, IDENTITY, INFO))


@pytest.fixture(scope="module")
def received() -> Iterator[dict[str, str]]:
    """Descriptions by source_id, as inlets of real outlets of every declared stream get them."""
    outlets = [
        Outlet(stream, replace(IDENTITY, sensor=name), INFO) for name, stream in declared_streams()
    ]
    wanted = {outlet.source_id for outlet in outlets}
    resolver = pylsl.ContinuousResolver(forget_after=60.0)
    found: dict[str, pylsl.StreamInfo] = {}
    deadline = time.monotonic() + DEADLINE_S
    while not wanted <= found.keys() and time.monotonic() < deadline:
        time.sleep(0.1)
        found = {info.source_id(): info for info in resolver.results()}
    assert wanted <= found.keys()
    yield {
        source_id: pylsl.StreamInlet(found[source_id], recover=False).info(DEADLINE_S).as_xml()
        for source_id in wanted
    }
    outlets.clear()


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "stream"), [pytest.param(n, s, id=f"{n}/{s.data_name}") for n, s in declared_streams()]
)
def test_a_declaration_arrives_as_it_was_written(
    received: dict[str, str], name: str, stream: StreamSpec
) -> None:
    identity = replace(IDENTITY, sensor=name)
    header = read_header(received[naming.source_id(identity, stream.data_name)])
    assert not header.foreign
    assert header.identity == identity
    assert header.data_name == stream.data_name
    assert header.category == stream.category
    assert header.content_type == stream.content_type
    assert header.labels == stream.labels
    assert header.units == tuple(channel.unit for channel in stream.channels)
    assert header.roles == tuple(channel.role for channel in stream.channels)
    assert header.is_state == stream.is_state
    assert header.rate == pytest.approx(stream.rate)
    assert header.format == stream.format
    assert header.message_type == stream.message_type
    assert header.chunk == stream.chunk


# XML keeps no control characters, and pugixml no text of blanks alone.
field_texts = st.text(
    st.characters(exclude_categories=["Cc", "Cs", "Cn"]), max_size=MAX_FIELD_CHARACTERS
).map(str.strip)


@given(unit=field_texts, participant=field_texts, label=field_texts)
def test_a_device_may_be_called_anything(unit: str, participant: str, label: str) -> None:
    identity = DeviceIdentity("zephyr", unit, participant, label)
    stream = declaration("zephyr").stream("hr")
    xml = lsl_xml(stream, identity, describe(stream, identity, INFO))
    assert read_header(xml).identity == identity


def test_a_stream_of_another_program_is_mapped_by_its_name_and_type() -> None:
    info = pylsl.StreamInfo("Some App", "EEG", 2, 256.0, "double64", "app 1")
    header = read_header(info.as_xml())
    assert header.foreign
    assert header.identity == DeviceIdentity("Some App", "app 1")
    assert header.data_name == "EEG"
    assert header.labels == header.units == ("", "")
    assert header.message_type is MessageType.FLOAT64_MULTI_ARRAY
    assert header.chunk == "EEG"


def test_labels_and_units_of_another_program_are_read_if_there_are_as_many_as_channels() -> None:
    info = pylsl.StreamInfo("app", "EEG", 2, 0.0, "float32", "app 1")
    channels = info.desc().append_child("channels")
    channels.append_child("channel").append_child_value("label", "Fp1")
    assert read_header(info.as_xml()).labels == ("", "")
    channels.append_child("channel").append_child_value("label", "x" * 1000)
    assert read_header(info.as_xml()).labels == ("Fp1", "x" * MAX_FIELD_CHARACTERS)


def replace_text(old: str, new: str) -> str:
    xml = own_xml()
    assert xml.count(old) == 1
    return xml.replace(old, new)


BLOCK = "<biosensor>"


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("<sensor>zephyr</sensor>", "<sensor>../../x</sensor>", SpecReason.INVALID),
        ("<sensor>zephyr</sensor>", "<sensor>polar_h10</sensor>", SpecReason.CONTRADICTORY),
        ("<sensor>zephyr</sensor>", "", SpecReason.MALFORMED),
        ("<unit>BH1</unit>", "<unit>a</unit><unit>b</unit>", SpecReason.MALFORMED),
        ("<unit>BH1</unit>", f"<unit>{'u' * 129}</unit>", SpecReason.TOO_LARGE),
        ("<data_name>ecg</data_name>", "<data_name>ecg_chunk</data_name>", SpecReason.INVALID),
        ("<data_name>ecg</data_name>", "<data_name>hr</data_name>", SpecReason.CONTRADICTORY),
        ("<chunk>ecg</chunk>", "<chunk>A B</chunk>", SpecReason.INVALID),
        ("<category>raw</category>", "<category>Raw</category>", SpecReason.INVALID),
        ("msg/Float32<", "msg/Float99<", SpecReason.INVALID),
        ("msg/Float32<", "msg/String<", SpecReason.CONTRADICTORY),
        ("msg/Float32<", "msg/Int32MultiArray<", SpecReason.CONTRADICTORY),
        ("msg/Float32<", "msg/Int64MultiArray<", SpecReason.CONTRADICTORY),
        (">2<", ">3<", SpecReason.UNKNOWN_VERSION),
        ("<nominal_srate>250", "<nominal_srate>0.0</nominal_srate><x>", SpecReason.MALFORMED),
        (BLOCK, f"<biosensor/>{BLOCK}", SpecReason.MALFORMED),
        ("<channel_count>1<", "<channel_count>2<", SpecReason.CONTRADICTORY),
        ("<channel_count>1<", "<channel_count>0<", SpecReason.INVALID),
        ("<channel_count>1<", "<channel_count>4097<", SpecReason.INVALID),
        ("<channel_count>1<", "<channel_count>one<", SpecReason.MALFORMED),
        ("<channel_format>float32<", "<channel_format>float16<", SpecReason.MALFORMED),
        ("<channel_format>float32<", "<channel_format>string<", SpecReason.CONTRADICTORY),
        ("<?xml", "<!DOCTYPE a><?xml", SpecReason.MALFORMED),
        (BLOCK, f"<!ENTITY a 'b'>{BLOCK}", SpecReason.MALFORMED),
        (BLOCK, f"<![CDATA[x]]>{BLOCK}", SpecReason.MALFORMED),
        (BLOCK, f"&undefined;{BLOCK}", SpecReason.MALFORMED),
        (BLOCK, "", SpecReason.MALFORMED),
    ],
)
def test_a_block_that_breaks_a_rule_is_refused(old: str, new: str, reason: SpecReason) -> None:
    if reason is SpecReason.UNKNOWN_VERSION:
        old, new = "<version>1</version>\n\t\t\t<sensor>", "<version>2</version><sensor>"
    with pytest.raises(SpecError) as refused:
        read_header(replace_text(old, new))
    assert refused.value.reason is reason
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("rate", ["nan", "inf", "-1"])
def test_an_impossible_rate_is_refused(rate: str) -> None:
    root = ET.fromstring(own_xml())
    field = root.find("nominal_srate")
    assert field is not None
    field.text = rate
    with pytest.raises(SpecError) as refused:
        read_header(ET.tostring(root, encoding="unicode"))
    assert refused.value.reason is SpecReason.INVALID


def test_an_irregular_stream_may_not_claim_chunks() -> None:
    stream = replace(declaration("zephyr").stream("hr"), chunk="")
    desc = describe(stream, IDENTITY, INFO)
    chunk = desc.find("biosensor/chunk")
    assert chunk is not None
    chunk.text = "hr"
    with pytest.raises(SpecError) as refused:
        read_header(lsl_xml(stream, IDENTITY, desc))
    assert refused.value.reason is SpecReason.CONTRADICTORY


def test_elements_of_later_versions_are_ignored() -> None:
    xml = replace_text(BLOCK, f"{BLOCK}<colour>red</colour>")
    assert read_header(xml) == read_header(own_xml())


def test_the_limit_of_size_is_exact() -> None:
    xml = own_xml()
    filled = xml.replace(BLOCK, f"<!--{'x' * (MAX_XML_CHARACTERS - len(xml) - 7)}-->{BLOCK}")
    assert len(filled) == MAX_XML_CHARACTERS
    assert read_header(filled) == read_header(xml)
    with pytest.raises(SpecError) as refused:
        read_header(filled + " ")
    assert refused.value.reason is SpecReason.TOO_LARGE


def test_a_billion_laughs_are_not_laughed() -> None:
    entities = "".join(f'<!ENTITY l{level} "{f"&l{level - 1};" * 10}">' for level in range(1, 10))
    xml = f'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY l0 "ha">{entities}]><info>&l9;</info>'
    with pytest.raises(SpecError) as refused:
        read_header(xml)
    assert refused.value.reason is SpecReason.MALFORMED


def test_deep_nesting_is_harmless() -> None:
    depth = MAX_XML_CHARACTERS // 7 - 1000
    nest = "<a>" * depth + "</a>" * depth
    assert read_header(replace_text(BLOCK, nest + BLOCK)) == read_header(own_xml())


tags = st.sampled_from(
    ["info", "desc", "biosensor", "version", "sensor", "channels", "channel", "label", "name"]
)
fragments = st.one_of(
    st.text(),
    st.sampled_from(["<!--", "-->", "<!", "<?xml ?>", "&amp;", "&#1;", "&#xD800;", "]]>", "\x00"]),
    tags.map(lambda tag: f"<{tag}>"),
    tags.map(lambda tag: f"</{tag}>"),
)


@given(parts=st.lists(fragments, max_size=20))
def test_no_text_raises_anything_but_a_spec_error(parts: list[str]) -> None:
    with suppress(SpecError):
        read_header("".join(parts))


@settings(max_examples=300)
@given(start=st.floats(0, 1), length=st.integers(0, 60), text=st.text(max_size=30))
def test_no_damage_raises_anything_but_a_spec_error(start: float, length: int, text: str) -> None:
    xml = own_xml()
    cut = int(start * len(xml))
    with suppress(SpecError):
        read_header(xml[:cut] + text + xml[cut + length :])


FIELDS = [field.tag for field in ET.fromstring(own_xml()).iterfind("desc/biosensor/*")]


@given(name=st.sampled_from(FIELDS), text=st.text(max_size=MAX_FIELD_CHARACTERS + 5))
def test_no_field_raises_anything_but_a_spec_error(name: str, text: str) -> None:
    stream = declaration("zephyr").stream("ecg")
    desc = describe(stream, IDENTITY, INFO)
    field = desc.find(f"biosensor/{name}")
    assert field is not None
    field.text = text.replace("\x00", "").encode("utf-8", "ignore").decode()
    with suppress(SpecError):
        header = read_header(lsl_xml(stream, IDENTITY, desc))
        assert naming.source_id(header.identity, header.data_name) == naming.source_id(
            IDENTITY, "ecg"
        )


@pytest.mark.parametrize("channel_format", ChannelFormat)
def test_every_format_of_another_program_has_a_message_type(channel_format: ChannelFormat) -> None:
    info = pylsl.StreamInfo("app", "X", 2, 10.0, channel_format.value, "app 1")
    header = read_header(info.as_xml())
    assert header.format is channel_format
    assert header.message_type.is_text == (channel_format is ChannelFormat.STRING)
    assert bool(header.chunk) != header.message_type.is_text
