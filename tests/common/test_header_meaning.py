"""What a header says of its channels and its stream counts; what it leaves unsaid is no guess."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import pylsl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common import naming
from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.known_senders import KNOWN
from biosensor_common.lsl_header import append_children, describe, read_header
from biosensor_common.naming import lsl_name, source_id
from biosensor_common.quantities import (
    ACCELERATION,
    MAGNETIC_FIELD,
    ORIENTATION,
    ChannelFormat,
    ChannelRole,
)
from biosensor_common.spec import DeviceIdentity, DeviceInfo
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
