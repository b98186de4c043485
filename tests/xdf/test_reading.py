"""What is read of a whole file, compared with pyxdf and with what was written."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.recording import read_recording
from tests.xdf import xdf_file as x
from tests.xdf.checking import load_by_pyxdf, read


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
        x.xdf(
            x.stream_header(1, "a", channels=3, rate=100.0, fmt=fmt),
            x.samples(1, fmt, values[:1], [49.5]),
            x.samples(1, fmt, values, stamps),
            x.samples(1, fmt, values, stamps),
        )
    )
    (stream,) = read_recording(path).streams
    (theirs,) = load_by_pyxdf(path)
    assert stream.sample_count == 13
    assert stream.stamps == pytest.approx(theirs["time_stamps"], abs=1e-9, rel=0)


def test_text_is_read_with_its_stamps() -> None:
    rows = [["näher", "b"], ["", "d"], ["e" * 300, "f"]]
    content = x.xdf(
        x.stream_header(3, "events", fmt="string", channels=2),
        x.samples(3, "string", rows, [1.5, None, 2.5]),
        x.footer(3, 3),
    )
    (stream,) = read(content).streams
    assert stream.stamps.tolist() == [1.5, 1.5, 2.5]
    assert not stream.texts, "only the agent's counters are kept"


def test_a_clock_that_was_not_measured_is_no_offset() -> None:
    content = x.xdf(
        x.stream_header(1, "a"),
        x.samples(1, "float32", [[1], [2]], [50.0, 60.0]),
        # What LabRecorder writes where the first question to a computer gets no answer.
        x.clock_offset(1, 0.0, 0.0),
        x.offsets(1, [55.0, 60.0], -3100.0),
        x.footer(1, 2),
    )
    (stream,) = read(content).streams
    assert stream.clock_offsets == [(55.0, -3100.0), (60.0, -3100.0)]


def test_values_that_are_missing_are_counted_by_channel() -> None:
    nan = float("nan")
    rows = [[1, nan], [nan, nan], [2, nan], [3, 4]]
    content = x.xdf(
        x.stream_header(1, "a", channels=2),
        x.samples(1, "float32", rows, [1, 2, 3, 4]),
        x.samples(1, "float32", rows, [5, None, 7, None]),
    )
    (stream,) = read(content).streams
    assert stream.nan_counts.tolist() == [2, 6]


def test_a_compressed_recording_is_read_alike() -> None:
    content = x.xdf(*x.regular(1, "a", [1.0, 1.1, 1.2], 10))
    plain, packed = read(content), read(gzip.compress(content), "study.xdfz")
    assert packed.streams[0].stamps.tolist() == plain.streams[0].stamps.tolist() == [1.0, 1.1, 1.2]
    assert not packed.damages
    twice = gzip.compress(content[:50]) + gzip.compress(content[50:])
    assert read(twice, "study.xdf.gz").streams[0].sample_count == 3


def test_a_compressed_recording_that_breaks_off_is_read_as_far_as_possible() -> None:
    times = np.random.default_rng(5).uniform(1, 9, 2000)
    blocks = [x.samples(1, "float32", [[1]], [float(time)]) for time in times]
    packed = gzip.compress(x.xdf(x.stream_header(1, "a"), *blocks))
    recording = read(packed[: len(packed) // 2], "study.xdfz")
    assert 800 < recording.streams[0].sample_count < 1200
    assert recording.damages[-1].breaks_off


def test_chunk_lengths_may_be_of_every_size() -> None:
    header = x.stream_header(1, "a")[7:]
    for size in (4, 8):
        content = x.xdf(x.chunk(2, header, size), x.samples(1, "float32", [[1]], [1.0]))
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
