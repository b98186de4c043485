"""What is read of a whole file, compared with pyxdf and with what was written."""

from __future__ import annotations

import ast
import gzip
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import biosensor_gateway.recording
from biosensor_gateway.recording.recorder.request import RecorderReason
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.explanations import EXPLANATIONS
from biosensor_gateway.recording.xdf.findings import About, Finding, Level, in_order
from biosensor_gateway.recording.xdf.printing import as_json, as_text
from biosensor_gateway.recording.xdf.recording import read_recording
from tests.xdf import xdf_file as made
from tests.xdf.checking import check, load_by_pyxdf, read


@pytest.mark.parametrize("fmt", ["float32", "double64", "int8", "int16", "int32"])
@pytest.mark.parametrize(
    "given",
    [[True] * 6, [False] * 6, [True, False] * 3, [False, False, True, False, False, True]],
)
def test_stamps_are_those_that_pyxdf_reads(fmt: str, given: list[bool], tmp_path: Path) -> None:
    generator = np.random.default_rng(7)
    times = 50 + np.cumsum(generator.uniform(0.001, 0.3, len(given)))
    stamps = [float(t) if is_given else None for t, is_given in zip(times, given, strict=True)]
    values = [[1, 2, 3]] * len(given)
    path = tmp_path / "study.xdf"
    path.write_bytes(
        made.xdf(
            made.stream_header(1, "a", channels=3, rate=100.0, fmt=fmt),
            made.samples(1, fmt, values[:1], [49.5]),
            made.samples(1, fmt, values, stamps),
            made.samples(1, fmt, values, stamps),
        )
    )
    (stream,) = read_recording(path).streams
    (theirs,) = load_by_pyxdf(path)
    assert stream.sample_count == 13
    assert stream.stamps == pytest.approx(theirs["time_stamps"], abs=1e-9, rel=0)


def test_text_is_read_with_its_stamps() -> None:
    rows = [["näher", "b"], ["", "d"], ["e" * 300, "f"]]
    content = made.xdf(
        made.stream_header(3, "events", fmt="string", channels=2),
        made.samples(3, "string", rows, [1.5, None, 2.5]),
        made.footer(3, 3),
    )
    (stream,) = read(content).streams
    assert stream.stamps.tolist() == [1.5, 1.5, 2.5]
    assert not stream.texts, "only the agent's counters are kept"


def test_a_clock_that_was_not_measured_is_no_offset() -> None:
    content = made.xdf(
        made.stream_header(1, "a"),
        made.samples(1, "float32", [[1], [2]], [50.0, 60.0]),
        # What LabRecorder writes where the first question to a computer gets no answer.
        made.clock_offset(1, 0.0, 0.0),
        made.offsets(1, [55.0, 60.0], -3100.0),
        made.footer(1, 2),
    )
    (stream,) = read(content).streams
    assert stream.clock_offsets == [(55.0, -3100.0), (60.0, -3100.0)]


def test_values_that_are_missing_are_counted_by_channel() -> None:
    nan = float("nan")
    rows = [[1, nan], [nan, nan], [2, nan], [3, 4]]
    content = made.xdf(
        made.stream_header(1, "a", channels=2),
        made.samples(1, "float32", rows, [1, 2, 3, 4]),
        made.samples(1, "float32", rows, [5, None, 7, None]),
    )
    (stream,) = read(content).streams
    assert stream.nan_counts.tolist() == [2, 6]


def test_a_compressed_recording_is_read_alike() -> None:
    content = made.xdf(*made.regular(1, "a", [1.0, 1.1, 1.2], 10))
    plain, packed = read(content), read(gzip.compress(content), "study.xdfz")
    assert packed.streams[0].stamps.tolist() == plain.streams[0].stamps.tolist() == [1.0, 1.1, 1.2]
    assert not packed.damages
    twice = gzip.compress(content[:50]) + gzip.compress(content[50:])
    assert read(twice, "study.xdf.gz").streams[0].sample_count == 3


def test_a_compressed_recording_that_breaks_off_is_read_as_far_as_possible() -> None:
    times = np.random.default_rng(5).uniform(1, 9, 2000)
    blocks = [made.samples(1, "float32", [[1]], [float(time)]) for time in times]
    packed = gzip.compress(made.xdf(made.stream_header(1, "a"), *blocks))
    recording = read(packed[: len(packed) // 2], "study.xdfz")
    assert 800 < recording.streams[0].sample_count < 1200
    assert recording.damages[-1].breaks_off


def test_chunk_lengths_may_be_of_every_size() -> None:
    header = made.stream_header(1, "a")[7:]
    for size in (4, 8):
        content = made.xdf(made.chunk(2, header, size), made.samples(1, "float32", [[1]], [1.0]))
        assert read(content).streams[0].sample_count == 1


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (None, RecordingReason.NOT_FOUND),
        (b"", RecordingReason.NOT_XDF),
        (b"XDF", RecordingReason.NOT_XDF),
        (b"PK\x03\x04 something else", RecordingReason.NOT_XDF),
        (gzip.compress(b"something else", mtime=0), RecordingReason.NOT_XDF),
        (b"\x1f\x8bno gzip at all", RecordingReason.NOT_XDF),
    ],
)
def test_what_is_no_recording_is_said_in_one_sentence(
    content: bytes | None, reason: RecordingReason, tmp_path: Path
) -> None:
    path = tmp_path / "study.xdf"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RecordingError) as caught:
        read_recording(path)
    assert caught.value.reason is reason
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_is_no_recording(tmp_path: Path) -> None:
    with pytest.raises(RecordingError) as caught:
        read_recording(tmp_path)
    assert caught.value.reason is RecordingReason.UNREADABLE


# Every finding about a recording is explained, sorted by what it is about, and milder of us.
ROOM = Path(next(iter(biosensor_gateway.recording.__path__)))


def _codes(tree: ast.AST) -> Iterator[str]:
    """Give what stands behind a level, in a call of `Finding` or a tuple of a rule."""
    for node in ast.walk(tree):
        parts: list[ast.expr] = []
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "Finding":
            parts = node.args
        elif isinstance(node, ast.Tuple) and len(node.elts) == 3:
            parts = node.elts
        if len(parts) < 3 or not ast.unparse(parts[0]).lower().startswith("level"):
            continue
        if isinstance(parts[1], ast.Constant) and isinstance(parts[1].value, str):
            yield parts[1].value


def _all_codes() -> set[str]:
    return {
        code
        for path in ROOM.rglob("*.py")
        for code in _codes(ast.parse(path.read_text(encoding="utf-8")))
    }


def test_every_code_is_explained_and_every_explanation_is_of_a_code() -> None:
    found = _all_codes()
    assert len(found) > 40
    assert found - EXPLANATIONS.keys() - {each.value for each in RecorderReason} == set()
    assert EXPLANATIONS.keys() - found == set()


def test_findings_come_by_what_they_are_about_and_then_the_worst_first() -> None:
    findings = [
        Finding(Level.ERROR, "gaps", "a", "", About.OURSELVES),
        Finding(Level.NOTE, "gaps", "b", ""),
        Finding(Level.ERROR, "gaps", "c", "", About.OTHERS),
        Finding(Level.ERROR, "gaps", "d", ""),
    ]
    assert [each.stream for each in in_order(findings)] == ["d", "b", "c", "a"]


@pytest.mark.parametrize(
    ("level", "milder"),
    [(Level.ERROR, Level.WARNING), (Level.WARNING, Level.NOTE), (Level.NOTE, Level.NOTE)],
)
def test_what_we_record_of_ourselves_is_milder(level: Level, milder: Level) -> None:
    finding = Finding(level, "rate", "gateway/counters", "")
    assert finding.of(About.OURSELVES).level is milder
    assert finding.of(About.OTHERS).level is level


def test_the_report_says_what_findings_of_strangers_mean() -> None:
    header = made.stream_header(1, "theirs", rate=100.0, source_id="")
    stamps = [50.0 + each / 100 for each in range(300)]
    content = made.xdf(header, made.samples(1, "float32", [[1.0]] * 300, stamps))
    report = check(content)
    found = next(each for each in report.findings if each.code == "no-source-id")
    assert found.about is About.OTHERS
    told = {each["code"]: each for each in json.loads(as_json(report))["findings"]}
    assert told["no-source-id"]["about"] == "others"
    assert told["no-source-id"]["means"] == EXPLANATIONS["no-source-id"].means
    lines = as_text(report).splitlines()
    heading = lines.index("of other programs' streams:")
    assert heading > next(at for at, line in enumerate(lines) if "no stream has a footer" in line)
