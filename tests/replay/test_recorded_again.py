"""A replay that LabRecorder records equals its source, sample by sample."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.verdict import judge
from tests.replay import files
from tests.replay.files import playing
from tests.rigs.lab_recorder import LabRecorder
from tests.xdf.own_streams import description

pytestmark = pytest.mark.nightly

SECONDS = 5.0
STREAMS = 7
# Doubles of a few thousand seconds are exact to a picosecond; the rest is room for arithmetic.
SAME_S = 1e-6
TAKEN_IN_S = 3.0
"""LabRecorder takes samples in twice a second, and not once more when it stops."""


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    ours = description("polar_h10", "ecg", "P1")
    return files.write(
        tmp_path_factory.mktemp("source") / "study.xdf",
        files.regular(
            1, "P1-polar_h10-u1-ecg", 130.0, SECONDS, source_id="P1@polar_h10-ecg", desc=ours
        ),
        files.regular(2, "gappy", 250.0, SECONDS, fmt="double64", gap=(1.0, 2.2)),
        # The same name and source_id as another one, and a clock of a week ago.
        files.regular(3, "gappy", 50.0, 3.0, begin_s=1.0, offset_s=600_000.0, source_id="gappy-id"),
        files.regular(4, "counts", 100.0, SECONDS, fmt="int16", source_id="", desc=files.STRANGE),
        files.regular(5, "bytes", 32.0, SECONDS, fmt="int8"),
        files.regular(6, "numbers", 64.0, SECONDS, fmt="int32"),
        files.texts(7, "marks", [0.25, 0.25, 0.8, 1.5, 3.0, 3.001, 4.9]),
    )  # fmt: skip


@pytest.fixture(scope="module")
def again(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("again") / "again.xdf"
    with playing(source, "--wait-for-consumers") as replay:
        assert f"{STREAMS} streams, 0:00:04" in replay.begun()
        with LabRecorder(path, at_least=STREAMS):
            assert replay.ended() == 0, replay.said
            time.sleep(TAKEN_IN_S)
    assert "samples were sent" in replay.said
    return path


@pytest.mark.seam
def test_every_sample_is_the_same_at_the_same_distance(source: Path, again: Path) -> None:
    with open_contents(source) as before, open_contents(again) as after:
        pairs = [(each, _played(each, after.streams)) for each in before.streams]
        times = {each.number: _samples(each)[0] for each in before.streams}
        first = min(times, key=lambda number: times[number][0])
        start_s = next(_stamps(played)[0] for each, played in pairs if each.number == first)
        for each, played in pairs:
            expected = times[each.number] - times[first][0] + start_s
            assert played.header.format is each.header.format
            assert np.abs(_stamps(played) - expected).max() < SAME_S, each.header.name
            assert _samples(played)[1] == _samples(each)[1], each.header.name


@pytest.mark.seam
def test_the_description_is_the_same_but_for_the_replay(source: Path, again: Path) -> None:
    with open_contents(source) as before, open_contents(again) as after:
        for each in before.streams:
            recorded = _played(each, after.streams).header
            root = ET.fromstring(recorded.xml)
            desc = root.find("desc")
            assert desc is not None
            block = desc.find("replay")
            assert block is not None
            desc.remove(block)
            expected = ET.fromstring(each.header.xml).find("desc")
            assert expected is not None
            assert _plain(desc) == _plain(expected)
            assert (recorded.name, recorded.content_type) == (
                each.header.name,
                each.header.content_type,
            )
            assert recorded.rate == each.header.rate
            assert recorded.identity == each.header.identity
            assert recorded.source_id.startswith("replay:")
            assert recorded.replay is not None
            assert (recorded.replay.file, recorded.replay.speed) == ("study.xdf", 1.0)


def test_the_check_of_the_new_recording_says_that_it_is_a_replay(again: Path) -> None:
    findings = judge(read_recording(again)).findings
    (found,) = [each for each in findings if each.code == "replay"]
    assert found.level is Level.WARNING
    assert f"{STREAMS} streams are a replay of study.xdf" in found.text
    # Each has an id of its own, though two of the source shared one and one had none.
    assert not [each for each in findings if each.code in ("duplicate-source-id", "no-source-id")]


def _played(stream: Stream, streams: tuple[Stream, ...]) -> Stream:
    def is_it(played: Stream) -> bool:
        header = played.header
        is_same = (header.name, header.rate) == (stream.header.name, stream.header.rate)
        return is_same and header.replay is not None

    (found,) = filter(is_it, streams)
    assert found.header.replay is not None
    assert found.header.replay.source_id == stream.header.source_id
    return found


def _samples(stream: Stream) -> tuple[Any, list[Any]]:
    """Times on the recorder's clock, and all values as they were."""
    blocks = list(stream.blocks())
    values: list[Any] = []
    for block in blocks:
        numbers = None if isinstance(block.values, list) else np.asarray(block.values)
        values += block.values if numbers is None else [each.tobytes() for each in numbers]
    return np.concatenate([each.times for each in blocks]), values


def _stamps(stream: Stream) -> Any:
    return np.concatenate([each.stamps for each in stream.blocks()])


def _plain(element: ET.Element) -> Any:
    """All of an element but the indentation, which LSL changes."""
    texts = ((element.text or "").strip(), (element.tail or "").strip())
    return element.tag, element.attrib, texts, [_plain(child) for child in element]
