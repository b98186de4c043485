"""What other programs write, and crashes leave, that costs nothing, or is said as what it is."""

from __future__ import annotations

import struct
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.recording.xdf.header import decoded
from tests.xdf import xdf_file as x
from tests.xdf.checking import check, codes, only, text_of

STAMPS = [1000.0 + k / 100 for k in range(2000)]
CHUNKS = [
    x.samples(1, "float32", [[0.5]] * 100, STAMPS[at : at + 100])
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


def test_samples_that_are_there_twice_begin_a_run() -> None:
    report = check(x.xdf(HEADER, *CHUNKS[:10], CHUNKS[9], *CHUNKS[10:], END))
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
            x.samples(1, "float32", [[0.5]] * 1000, before.tolist()),
            x.offsets(1, (5.0, 10.0), 1055.0),
            x.samples(1, "float32", [[0.5]] * 1000, begun_again.tolist()),
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
