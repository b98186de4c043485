"""A header says of which recording its stream is played, and only then may its source_id differ."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.lsl_header import describe, read_header
from biosensor_common.naming import lsl_name, source_id
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_common.stream_header import Replay, mark_as_replay, read_replay, replay_source_id
from biosensor_gateway.devices.registry import declaration

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
