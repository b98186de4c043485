"""What a header says of its channels and its stream counts; what it leaves unsaid is no guess."""

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
from biosensor_common.known_senders import KNOWN
from biosensor_common.lsl_header import MAX_XML_CHARACTERS, append_children, describe, read_header
from biosensor_common.naming import lsl_name, source_id
from biosensor_common.quantities import (
    ACCELERATION,
    MAGNETIC_FIELD,
    ORIENTATION,
    ChannelFormat,
    ChannelRole,
    MessageType,
)
from biosensor_common.spec import DeviceIdentity, DeviceInfo, StreamSpec
from biosensor_common.stream_header import (
    MAX_FIELD_CHARACTERS,
    CoreFields,
    Replay,
    StreamHeader,
    foreign_header,
    mark_as_replay,
    read_replay,
    replay_source_id,
)
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet
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


# A header says of which recording its stream is played, and only then may its source_id differ.

IDENTITY = DeviceIdentity("polar_h10", "U1", "P1")
REPLAY = Replay("study.xdf", source_id(IDENTITY, "hr"), 0.0, 1.0, 4711.25)
XML_TEXT = st.text(
    st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"], exclude_characters="\ufffe\uffff")
)
FINITE = st.floats(allow_nan=False, allow_infinity=False)


def header(own_id: str, replay: Replay | None, *, ours: bool = True) -> str:
    stream = declaration("polar_h10").stream("hr")
    root = ET.Element("info")
    for tag, text in {
        "name": lsl_name(IDENTITY, "hr"),
        "type": stream.content_type.value,
        "channel_count": "1",
        "nominal_srate": "0",
        "channel_format": stream.format.value,
        "source_id": own_id,
    }.items():
        ET.SubElement(root, tag).text = text
    desc = describe(stream, IDENTITY, DeviceInfo()) if ours else ET.Element("desc")
    root.append(desc)
    if replay is not None:
        mark_as_replay(desc, replay)
    return ET.tostring(root, encoding="unicode")


def test_a_replay_is_known_by_its_block_and_keeps_its_identity() -> None:
    played = read_header(header(replay_source_id("0ab1", REPLAY.source_id), REPLAY))
    assert (played.identity, played.data_name, played.foreign) == (IDENTITY, "hr", False)
    assert played.replay == REPLAY
    assert read_header(header(REPLAY.source_id, REPLAY)).replay == REPLAY
    assert read_header(header("replay:0ab1:x", REPLAY, ours=False)).replay == REPLAY


def test_without_the_block_another_source_id_is_a_lie() -> None:
    with pytest.raises(SpecError) as caught:
        read_header(header(replay_source_id("0ab1", REPLAY.source_id), None))
    assert caught.value.reason is SpecReason.CONTRADICTORY
    other = Replay("study.xdf", "P2@polar_h10-hr", 0.0, 1.0, 0.0)
    with pytest.raises(SpecError) as caught:
        read_header(header("replay:0ab1:P2@polar_h10-hr", other))
    assert caught.value.reason is SpecReason.CONTRADICTORY


@given(XML_TEXT, XML_TEXT, st.floats(0, 1e9), st.floats(1e-3, 1e3), FINITE)
def test_what_is_written_is_read(
    file: str, recorded: str, rate: float, speed: float, start_s: float
) -> None:
    replay = Replay(file, recorded, rate, speed, start_s)
    root = ET.Element("info")
    desc = ET.SubElement(root, "desc")
    mark_as_replay(desc, REPLAY)
    mark_as_replay(desc, replay)
    assert read_replay(ET.fromstring(ET.tostring(root))) == replay


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("<speed>1.0", "<speed>0"), SpecReason.INVALID),
        (("<speed>1.0", "<speed>fast"), SpecReason.INVALID),
        (("<start>4711.25", "<start>nan"), SpecReason.INVALID),
        (("study.xdf", "s" * 2000), SpecReason.TOO_LARGE),
        (("</replay>", "</replay><replay/>"), SpecReason.MALFORMED),
    ],
)
def test_what_makes_no_sense_is_refused(change: tuple[str, str], reason: SpecReason) -> None:
    with pytest.raises(SpecError) as caught:
        read_header(header(REPLAY.source_id, REPLAY).replace(*change))
    assert caught.value.reason is reason


# What streams of other programs are called, as their makers document them.

HOST = "labpc"
# Name, type and source id as the programs say them, and the topic that a person expects.
STREAMS = [
    ("lab phone_Neon Gaze", "Gaze", "any", "pupil_neon/gaze"),
    ("lab phone_Neon Events", "Event", "any", "pupil_neon/events"),
    ("pupil_labs_Gaze", "Gaze", "a1b2_Gaze", "pupil_invisible/gaze"),
    ("pupil_labs_Event", "Event", "a1b2_Event", "pupil_invisible/events"),
    ("Tobii_gaze", "Gaze", "TittaLSL:Tobii_gaze@TPFC2-0101", "tobii/gaze"),
    ("Tobii_eyeOpenness", "Gaze", "TittaLSL:Tobii_eyeOpenness@TPFC2-0101", "tobii/eye_openness"),
    ("Tobii_time_sync", "TimeSync", "TittaLSL:Tobii_time_sync@T1", "tobii/time_sync"),
    ("Tobii", "Gaze", "Tobiiat_tet-tcp://169.254.10.20", "tobii/gaze"),
    ("EmotivDataStream-EEG", "EEG", "", "emotivpro/eeg"),
    ("EmotivDataStream-Motion", "Motion", "", "emotivpro/motion"),
    ("EmotivDataStream-Performance-Metrics", "", "", "emotivpro/performance_metrics"),
    ("EmotivDataStream-Performance Metrics", "", "", "emotivpro/performance_metrics"),
    ("EmotivDataStream-Band-Power", "", "", "emotivpro/band_power"),
    ("obci_eeg2", "EEG", "openbcigui", "openbci/eeg2"),
    ("OpenSignals", "00:07:80:65:E0:19", "", "opensignals/data"),
    ("MNE-LSL-Player", "eeg", "MNE-LSL", "mne_lsl_player/data"),
    ("MNE-LSL-Player-annotations", "annotations", "MNE-LSL", "mne_lsl_player/annotations"),
]
OTHERS = [
    ("obci_eeg1", "EEG", "somebody's own"),
    ("Tobii", "Gaze", "a script"),
    ("my_Gaze", "Gaze", "a1b2_Gaze"),
    ("OpenSignals2", "EEG", "x"),
    ("xEmotivDataStream-EEG", "EEG", "x"),
]


def _header(
    name: str,
    content_type: str,
    source_id: str,
    channels: int,
    labels: tuple[str, ...] = (),
    units: tuple[str, ...] = (),
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    rate = 100.0
    core = CoreFields(name, content_type, source_id, HOST, channels, rate, ChannelFormat.FLOAT32)
    header = foreign_header(core, labels, units)
    return header.labels, header.units


@pytest.mark.parametrize(("name", "content_type", "source_id", "topic"), STREAMS)
def test_a_known_program_has_topics_that_a_person_expects(
    name: str, content_type: str, source_id: str, topic: str
) -> None:
    found = naming.foreign_identity(name, content_type, source_id, HOST)
    assert naming.topic(*found) == f"biosensors/{topic}"


@pytest.mark.parametrize(("name", "content_type", "source_id"), OTHERS)
def test_another_program_keeps_the_names_that_it_says(
    name: str, content_type: str, source_id: str
) -> None:
    found = naming.foreign_identity(name, content_type, source_id, HOST)
    assert found == (DeviceIdentity(name, source_id), content_type)


def test_every_entry_is_seen_here() -> None:
    seen = {
        (identity.sensor, data_name)
        for identity, data_name in (
            naming.foreign_identity(name, content_type, source_id, HOST)
            for name, content_type, source_id, _ in STREAMS
        )
    }
    missing = {(stream.sensor, stream.data_name) for stream in KNOWN} - seen
    assert {sensor for sensor, _ in missing} <= {"tobii", "emotivpro", "openbci"}


def test_streams_of_one_device_belong_together_and_two_devices_are_told_apart() -> None:
    streams = {
        name: naming.foreign_identity(name, "", f"id of {name}", HOST)
        for phone in ("left", "right")
        for name in (f"{phone}_Neon Gaze", f"{phone}_Neon Events")
    }
    bases = {name: topics.base for name, topics in naming.resolve_topics(streams).items()}
    assert bases["left_Neon Gaze"] == bases["left_Neon Events"] == "biosensors/pupil_neon_left"
    assert bases["right_Neon Gaze"] == "biosensors/pupil_neon_right"


class TestChannels:
    def test_without_a_unit_have_the_documented_one(self) -> None:
        labels = ("x", "y", "PupilDiameter", "PupilDiameter", "something else")
        assert _header("a_Neon Gaze", "Gaze", "", 5, labels) == (
            labels,
            ("pixels", "pixels", "mm", "mm", ""),
        )

    def test_keep_the_units_that_they_say(self) -> None:
        _, units = _header("a_Neon Gaze", "Gaze", "", 2, ("x", "y"), ("degrees", ""))
        assert units == ("degrees", "pixels")

    def test_without_labels_have_the_documented_ones(self) -> None:
        labels, units = _header("EmotivDataStream-Motion", "", "", 13)
        assert labels[3:8] == ("Q0", "Q1", "Q2", "Q3", "ACCX")
        assert units[7] == "g"
        assert units[-1] == "uT"

    def test_are_nameless_where_their_number_is_another(self) -> None:
        assert _header("EmotivDataStream-Motion", "", "", 4) == (("",) * 4, ("",) * 4)


# Descriptions survive LSL unchanged, and whatever comes from a network is read safely.

DEVICE = DeviceInfo("maker", "model", "serial <1> & 'so' on", "1.2")
SENDER = DeviceIdentity("zephyr", "BH1", participant="p01", label="left")
DEADLINE_S = 30.0


def own_xml() -> str:
    stream = declaration("zephyr").stream("ecg")
    return lsl_xml(stream, SENDER, describe(stream, SENDER, DEVICE))


@pytest.fixture(scope="module")
def received() -> Iterator[dict[str, str]]:
    """Descriptions by source_id, as inlets of real outlets of every declared stream get them."""
    outlets = [
        Outlet(stream, replace(SENDER, sensor=name), DEVICE) for name, stream in declared_streams()
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
    identity = replace(SENDER, sensor=name)
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
    xml = lsl_xml(stream, identity, describe(stream, identity, DEVICE))
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
    desc = describe(stream, SENDER, DEVICE)
    chunk = desc.find("biosensor/chunk")
    assert chunk is not None
    chunk.text = "hr"
    with pytest.raises(SpecError) as refused:
        read_header(lsl_xml(stream, SENDER, desc))
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
    desc = describe(stream, SENDER, DEVICE)
    field = desc.find(f"biosensor/{name}")
    assert field is not None
    field.text = text.replace("\x00", "").encode("utf-8", "ignore").decode()
    with suppress(SpecError):
        header = read_header(lsl_xml(stream, SENDER, desc))
        assert naming.source_id(header.identity, header.data_name) == naming.source_id(
            SENDER, "ecg"
        )


@pytest.mark.parametrize("channel_format", ChannelFormat)
def test_every_format_of_another_program_has_a_message_type(channel_format: ChannelFormat) -> None:
    info = pylsl.StreamInfo("app", "X", 2, 10.0, channel_format.value, "app 1")
    header = read_header(info.as_xml())
    assert header.format is channel_format
    assert header.message_type.is_text == (channel_format is ChannelFormat.STRING)
    assert bool(header.chunk) != header.message_type.is_text
