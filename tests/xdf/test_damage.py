"""Files that break off, were changed or written by others: what is read, and what is named."""

from __future__ import annotations

import ast
import gzip
import json
import logging
import random
import struct
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import biosensor_gateway.recording
from biosensor_gateway.recording.recorder.request import RecorderReason
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.explanations import EXPLANATIONS
from biosensor_gateway.recording.xdf.findings import About, Finding, Level, in_order
from biosensor_gateway.recording.xdf.header import decoded
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.report_text import as_json, as_text
from biosensor_gateway.recording.xdf.verdict import judge
from tests.xdf import xdf_file as made
from tests.xdf import xdf_file as x
from tests.xdf.checking import check, codes, load_by_pyxdf, only, read, text_of
from tests.xdf.xdf_file import two_streams

# Files that break off or were changed: all that can be read is read, never a traceback.

PARTS = two_streams()
WHOLE = b"".join(PARTS)
ENDS = np.cumsum([len(part) for part in PARTS]).tolist()


def _report(content: bytes) -> None:
    """Do all that the command does."""
    report = check(content)
    json.loads(as_json(report))
    assert as_text(report)


def test_the_whole_file_is_all_right() -> None:
    assert check(WHOLE).is_good


@pytest.mark.parametrize("end", ENDS[:-1])
def test_cut_between_two_chunks(end: int) -> None:
    report = check(WHOLE[:end])
    assert not report.recording.damages
    assert not report.is_good
    whole = [part for part, until in zip(PARTS, ENDS, strict=True) if until <= end]
    held = sum(4 for part in whole if part[5:11] == b"\x03\0\x01\0\0\0")
    streams = {each.name: each.stream for each in report.streams}
    assert sum(stream.sample_count for n, stream in streams.items() if n == "numbers") == held
    if "events" in streams:
        assert len(streams) == 2


def test_cut_anywhere_it_says_where(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL)
    generator = random.Random(11)
    after_headers = ENDS[3]
    path = tmp_path / "cut.xdf"
    for end in generator.sample(sorted(set(range(after_headers + 1, len(WHOLE))) - set(ENDS)), 150):
        path.write_bytes(WHOLE[:end])
        report = judge(read_recording(path))
        (damage,) = report.recording.damages
        begin = max(until for until in ENDS if until < end)
        assert (damage.start, damage.end, damage.breaks_off) == (begin, end, True)
        sentence = text_of(report, "damaged")
        assert f"breaks off at byte {begin} of {end}" in sentence
        # pyxdf takes in what there is of a cut sample, and cannot bear other cut chunks.
        if end - begin > 11 and WHOLE[begin + 5] == 3:
            ours = [each.stream.sample_count for each in report.streams]
            theirs = [len(stream["time_stamps"]) for stream in load_by_pyxdf(path)]
            surplus = [b - a for a, b in zip(ours, theirs, strict=True)]
            assert min(surplus) == 0
            assert max(surplus) <= 4


@pytest.mark.parametrize("end", range(len(WHOLE) - 1, ENDS[-3], -7))
def test_cut_in_the_footers_loses_no_sample(end: int) -> None:
    recording = read(WHOLE[:end])
    assert [stream.sample_count for stream in recording.streams] == [160, 40]


@pytest.mark.parametrize("garbage", [b"\xff", b"\0", b"\x01", b"\x04", b"\x08"])
def test_after_a_damage_it_reads_on_at_the_next_whole_chunk(garbage: bytes) -> None:
    begin, end = ENDS[10], ENDS[13] - 1
    content = WHOLE[:begin] + garbage * (end - begin) + WHOLE[end:]
    report = check(content)
    (damage,) = report.recording.damages
    assert (damage.start, damage.end) == (begin, ENDS[13])
    assert {("damaged", ""), ("footer-count", "numbers")} <= codes(report)
    numbers, events = report.streams
    assert (numbers.stream.sample_count, events.stream.sample_count) == (160 - 4, 40 - 2)
    assert "the rest was read" in text_of(report, "damaged")


@pytest.mark.parametrize("flipped", range(7))
def test_a_changed_head_costs_one_chunk(flipped: int) -> None:
    for begin, end in pairwise(ENDS[3:-1]):
        content = bytearray(WHOLE)
        content[begin + flipped] ^= 0x15
        (damage,) = read(bytes(content)).damages
        assert (damage.start, damage.end) == (begin, end)


def test_where_chunks_have_no_known_stream_it_reads_on_at_the_next_boundary() -> None:
    foreign = x.samples(3, "float32", [[1.0]], [1.0])
    content = b"".join([*PARTS[:20], b"\xff" * 30, foreign * 3, x.boundary(), *PARTS[20:]])
    (damage,) = read(content).damages
    assert damage.end == ENDS[19] + 30 + 3 * len(foreign)
    assert content[damage.end :].startswith(x.boundary())


def test_a_length_that_hides_the_rest_is_not_believed() -> None:
    parts = list(PARTS)
    size = sum(len(part) for part in parts[20:])
    parts[20] = parts[20][:1] + (size - 5).to_bytes(4, "little") + parts[20][5:]
    (damage,) = read(b"".join(parts)).damages
    assert (damage.start, damage.end) == (ENDS[19], ENDS[20])


def test_one_bad_chunk_costs_itself_only() -> None:
    bad = x.chunk(3, b"\x01\0\0\0\x04\xff\xff\xff\xff")
    content = b"".join([*PARTS[:20], bad, *PARTS[20:]])
    report = check(content)
    assert codes(report, Level.ERROR) == {("damaged", "")}
    (damage,) = report.recording.damages
    assert (damage.start, damage.end) == (ENDS[19], ENDS[19] + len(bad))


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        (x.chunk(3, b"\x01"), "too short"),
        (x.chunk(4, b"\x01\0\0\0\0"), "size of a clock offset"),
        (x.clock_offset(1, float("nan"), 0), "not numbers"),
        (x.chunk(5, b"0123456789abcdef"), "not the one"),
        (x.chunk(2, b"\x07\0\0\0<info>"), "not well-formed"),
        (x.chunk(2, b"\x07\0\0\0<!DOCTYPE a><info/>"), "document type"),
        (x.stream_header(7, "none", channels=0), "number of channels"),
        (x.stream_header(7, "none", rate=-1.0), "nominal rate"),
        (x.stream_header(7, "none", fmt="float16"), "channel format"),
        (x.chunk(6, b"\x01\0\0\0</info>"), "not well-formed"),
        (x.chunk(3, b"\x01\0\0\0\x05\0"), "a length in it"),
        (x.chunk(3, b"\x01\0\0\0\x01\x01" + b"\x03" + bytes(16)), "distinguished"),
        (x.chunk(3, b"\x01\0\0\0\x01\x01" + b"\0" + bytes(9)), "do not fill it"),
        (x.chunk(3, b"\x02\0\0\0\x01\x01" + b"\0\x01\xffab"), "longer than the chunk"),
        (x.chunk(3, b"\x02\0\0\0\x01\x01" + b"\0\x01\x01ab"), "do not fill it"),
    ],
)
def test_a_bad_chunk_is_named(bad: bytes, why: str) -> None:
    report = check(b"".join([*PARTS[:20], bad, *PARTS[20:]]))
    assert why in text_of(report, "damaged")
    assert [each.stream.sample_count for each in report.streams] == [160, 40]


def test_behind_another_header_of_a_number_is_another_stream() -> None:
    """It may be another person's: two recordings were joined."""
    header = x.stream_header(1, "other", channels=2, rate=4.0)
    report = check(b"".join([*PARTS[:20], header, *PARTS[20:]]))
    counts = {each.name: each.stream.sample_count for each in report.streams}
    before = sum(x.is_samples(part, 1) for part in PARTS[:20])
    assert counts == {"numbers": 4 * before, "other": 160 - 4 * before, "events": 40}
    assert codes(report, Level.WARNING) >= {("one-number", "other")}
    assert not report.recording.damages
    assert report.can_be_salvaged


def test_behind_another_header_that_cannot_be_read_is_nobodys() -> None:
    header = x.chunk(2, b"\x01\0\0\0<info>")
    report = check(b"".join([*PARTS[:20], header, *PARTS[20:]]))
    before = sum(x.is_samples(part, 1) for part in PARTS[:20])
    assert [each.stream.sample_count for each in report.streams] == [4 * before, 40]
    assert "number 1" in text_of(report, "no-header")


def test_chunks_of_unknown_kinds_one_behind_the_other_cost_nothing() -> None:
    foreign = x.chunk(7, b"abc") + x.chunk(0xFFFF, b"") + x.chunk(8, bytes(300))
    report = check(b"".join([*PARTS[:20], foreign, *PARTS[20:]]))
    assert codes(report, Level.ERROR) == set()
    assert "3 chunks are skipped" in text_of(report, "foreign-chunk")


def test_zeros_behind_the_end_of_a_packed_file_are_no_damage(tmp_path: Path) -> None:
    path = tmp_path / "study.xdf.gz"
    path.write_bytes(gzip.compress(b"".join(PARTS)) + bytes(10_000))
    assert not read_recording(path).damages


def test_samples_without_a_header_are_said() -> None:
    report = check(b"".join([*PARTS[:2], *PARTS[3:]]))
    assert "number 1" in text_of(report, "no-header")
    assert [each.name for each in report.streams] == ["events"]


@settings(max_examples=200, deadline=None)
@given(
    changes=st.lists(
        st.tuples(st.integers(4, len(WHOLE) - 1), st.integers(0, 255)), min_size=1, max_size=30
    )
)
def test_changed_bytes_never_end_in_a_traceback(changes: list[tuple[int, int]]) -> None:
    content = bytearray(WHOLE)
    for place, value in changes:
        content[place] = value
    _report(bytes(content))


@settings(max_examples=100, deadline=None)
@given(start=st.integers(4, len(WHOLE)), gone=st.integers(0, 400), garbage=st.binary(max_size=200))
def test_replaced_stretches_never_end_in_a_traceback(start: int, gone: int, garbage: bytes) -> None:
    _report(WHOLE[:start] + garbage + WHOLE[start + gone :])


@settings(max_examples=100, deadline=None)
@given(tag=st.integers(1, 6), content=st.binary(max_size=60), stream_id=st.integers(1, 2))
def test_any_chunk_content_never_ends_in_a_traceback(
    tag: int, content: bytes, stream_id: int
) -> None:
    bad = x.chunk(tag, stream_id.to_bytes(4, "little") + content)
    _report(b"".join([*PARTS[:20], bad, *PARTS[20:]]))


# What other programs write, and crashes leave, that costs nothing, or is said as what it is.
STAMPS = [1000.0 + k / 100 for k in range(2000)]
CHUNKS = [
    x.samples(1, "float32", [[0.5], [1.5]] * 50, STAMPS[at : at + 100])
    for at in range(0, len(STAMPS), 100)
]
HEADER = x.stream_header(1, "ecg", kind="ECG", rate=100.0)
END = x.offsets(1, (1000.0, 1010.0)) + x.footer(1, len(STAMPS))


def test_a_chunk_of_another_kind_is_passed_over_and_said() -> None:
    report = check(x.xdf(HEADER, *CHUNKS[:5], x.chunk(9, b"12345678"), *CHUNKS[5:], END))
    assert codes(report) == {("foreign-chunk", "")}
    assert report.is_good
    assert only(report).stream.sample_count == len(STAMPS)


def test_the_same_header_once_more_says_nothing_new() -> None:
    report = check(x.xdf(HEADER, *CHUNKS[:5], HEADER, *CHUNKS[5:], END))
    assert not report.findings
    assert only(report).stream.sample_count == len(STAMPS)


def test_zeros_at_the_end_are_called_zeros() -> None:
    report = check(x.xdf(HEADER, *CHUNKS, END) + bytes(5000))
    assert "zeros" in text_of(report, "damaged")
    cut = x.xdf(HEADER, *CHUNKS, END)[:-10]
    assert "zeros" not in text_of(check(cut), "damaged")


def test_a_header_of_windows_is_read_and_said() -> None:
    name = "Gerät Übung"
    info = ET.fromstring(HEADER[5 + 2 + 4 :])
    info.find("name").text = name  # type: ignore[union-attr]
    xml = ET.tostring(info, encoding="unicode").encode("cp1252")
    report = check(x.xdf(x.chunk(2, struct.pack("<I", 1) + xml), *CHUNKS, END))
    assert codes(report) == {("not-utf8", name)}
    assert only(report).name == name


def test_texts_of_windows_are_read_and_counted() -> None:
    texts = ["Übung".encode("cp1252"), "Übung".encode(), b"exercise"]
    rows = b"".join(
        b"\x08" + struct.pack("<d", 1001.0 + k) + b"\x01" + bytes([len(text)]) + text
        for k, text in enumerate(texts)
    )
    report = check(
        x.xdf(
            x.stream_header(1, "markers", kind="Markers", fmt="string"),
            x.chunk(3, struct.pack("<I", 1) + b"\x01\x03" + rows),
            x.offsets(1, (1000.0, 1010.0)) + x.footer(1, 3),
        )
    )
    assert text_of(report, "not-utf8", "markers").startswith("1 of its texts")


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("Übung".encode(), ("Übung", False)),
        ("Übung".encode("cp1252"), ("Übung", True)),
        # UTF-8 with a damage stays UTF-8.
        ("Übung".encode() + b"\xff", ("Übung\N{REPLACEMENT CHARACTER}", True)),
        (b"\x81", ("\x81", True)),
    ],
)
def test_texts_that_are_not_utf8(content: bytes, expected: tuple[str, bool]) -> None:
    assert decoded(content) == expected


def test_samples_that_are_there_twice_in_other_chunks_begin_a_run() -> None:
    again = [
        x.samples(1, "float32", [[0.5], [1.5]] * 25, STAMPS[at : at + 50]) for at in (900, 950)
    ]
    report = check(x.xdf(HEADER, *CHUNKS[:10], *again, *CHUNKS[10:], END))
    assert codes(report, Level.ERROR) == {("footer-count", "ecg"), ("backwards", "ecg")}
    pace = only(report).figures.pace
    assert pace is not None
    assert pace.cuts == (1000,)
    assert pace.period_s == pytest.approx(0.01)


def test_the_times_of_a_clock_that_began_again_are_the_recorders() -> None:
    """The sender's computer was started again in the middle."""
    before, after = np.array(STAMPS[:1000]), np.array(STAMPS[1000:])
    begun_again = after - 1005.0
    report = check(
        x.xdf(
            HEADER,
            x.offsets(1, (1000.0, 1005.0), 50.0),
            x.samples(1, "float32", [[0.5], [1.5]] * 500, before.tolist()),
            x.offsets(1, (5.0, 10.0), 1055.0),
            x.samples(1, "float32", [[0.5], [1.5]] * 500, begun_again.tolist()),
            x.footer(1, len(STAMPS)),
        )
    )
    assert codes(report) == {("clock-reset", "ecg")}
    assert report.extent.length_s == pytest.approx(STAMPS[-1] - STAMPS[0])
    assert only(report).figures.rate_hz == pytest.approx(100.0)


def test_a_garbage_last_sample_is_not_called_an_older_recorder() -> None:
    stray = x.samples(1, "float32", [[0.0]], [STAMPS[-1] + 800_000.0])
    report = check(x.xdf(HEADER, *CHUNKS, stray, END))
    assert ("stray-stamps", "ecg") in codes(report, Level.ERROR)
    assert "older" not in text_of(report, "footer-count", "ecg")


# What is read of a whole file, compared with pyxdf and with what was written.


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
            # Otherwise it would be the chunk before, written twice.
            made.samples(1, fmt, [[4, 5, 6]] * len(given), stamps),
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
