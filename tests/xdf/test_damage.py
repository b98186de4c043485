"""Files that break off or were changed: all that can be read is read, never a traceback."""

from __future__ import annotations

import json
import logging
import random
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.judging import judge
from biosensor_gateway.recording.xdf.printing import as_json, as_text
from biosensor_gateway.recording.xdf.recording import read_recording
from tests.xdf import xdf_file as x
from tests.xdf.checking import check, codes, load_by_pyxdf, read, text_of
from tests.xdf.xdf_file import two_streams

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
    assert "what comes after was read" in text_of(report, "damaged")


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
        (x.clock_offset(1, float("nan"), 0), "no numbers"),
        (x.chunk(5, b"0123456789abcdef"), "not the one"),
        (x.stream_header(1, "again"), "second of stream number 1"),
        (x.chunk(2, b"\x07\0\0\0<info>"), "not well-formed"),
        (x.chunk(2, b"\x07\0\0\0<!DOCTYPE a><info/>"), "document type"),
        (x.stream_header(7, "none", channels=0), "number of channels"),
        (x.stream_header(7, "none", rate=-1.0), "nominal rate"),
        (x.stream_header(7, "none", fmt="float16"), "channel format"),
        (x.chunk(6, b"\x01\0\0\0</info>"), "not well-formed"),
        (x.chunk(3, b"\x01\0\0\0\x05\0"), "a length in it"),
        (x.chunk(3, b"\x01\0\0\0\x01\x01" + b"\x03" + bytes(16)), "told apart"),
        (x.chunk(3, b"\x01\0\0\0\x01\x01" + b"\0" + bytes(9)), "do not fill it"),
        (x.chunk(3, b"\x02\0\0\0\x01\x01" + b"\0\x01\xffab"), "longer than the chunk"),
        (x.chunk(3, b"\x02\0\0\0\x01\x01" + b"\0\x01\x01ab"), "do not fill it"),
    ],
)
def test_a_bad_chunk_is_named(bad: bytes, why: str) -> None:
    report = check(b"".join([*PARTS[:20], bad, *PARTS[20:]]))
    assert why in text_of(report, "damaged")
    assert [each.stream.sample_count for each in report.streams] == [160, 40]


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
