"""Headers of a wrong form are fixed, and lost ones are taken from another recording."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.salvage import printing
from biosensor_gateway.recording.xdf.salvage.outcome import salvage
from tests.xdf import xdf_file as made
from tests.xdf.salvaging import rows, salvaged

RATE, COUNT = 130.0, 50
VALUES = [[0.5 * number] for number in range(COUNT)]
STAMPS = [100.0 + number / RATE for number in range(COUNT)]
BODY = made.samples(1, "float32", VALUES, STAMPS) + made.footer(1, COUNT)
GOOD = made.stream_header(1, "Belt", rate=RATE)


def _broken(change: Callable[[str], str]) -> bytes:
    xml = GOOD[GOOD.index(b"<info>") :].decode()
    changed = change(xml).encode("utf-8", "surrogateescape")
    return made.xdf(made.chunk(2, struct.pack("<I", 1) + changed), BODY)


def _replaced(old: str, new: str) -> Callable[[str], str]:
    def change(xml: str) -> str:
        assert old in xml
        return xml.replace(old, new)

    return change


WRONG: dict[str, tuple[Callable[[str], str], str]] = {
    "a C string's end": (lambda xml: f"{xml}\0", "control characters"),
    "control characters": (_replaced("Belt", "Belt\x01"), "control characters"),
    "a comma": (_replaced("130.0", "130,0000"), "nominal_srate '130,0000'"),
    "the name of an enum": (_replaced("float32", "cf_float32"), "channel_format 'cf_float32'"),
    "blanks around the format": (_replaced("float32", " float32 "), "channel_format"),
    "a bare &": (_replaced("<hostname>host", "<hostname>R&D"), "a bare &"),
    "a document type": (lambda xml: f"<!DOCTYPE info>{xml}", "a document type"),
    "capitals": (_replaced("float32", "Float32"), "channel_format"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_header_of_a_wrong_form_costs_no_sample(name: str, tmp_path: Path) -> None:
    change, told = WRONG[name]
    outcome, file, _ = salvaged(_broken(change), tmp_path)
    assert rows(file)["Belt"] == list(zip(STAMPS, map(tuple, VALUES), strict=True))
    (sentence,) = (each for each in printing.after_table(outcome) if "was fixed" in each)
    assert told in sentence
    assert not outcome.lost_bytes


def test_a_stream_without_a_rate_is_irregular_then(tmp_path: Path) -> None:
    content = _broken(_replaced("<nominal_srate>130.0</nominal_srate>", ""))
    outcome, file, _ = salvaged(content, tmp_path)
    (stream,) = read_recording(file).streams
    assert (stream.header.rate, stream.sample_count) == (0.0, COUNT)
    assert any("no nominal_srate" in each for each in printing.after_table(outcome))


def _spoilt() -> bytes:
    """A recording whose header cannot be read any more, but for its number and name."""
    content = bytearray(made.xdf(GOOD, BODY))
    at = content.index(b"</info>", content.index(b"Belt"))
    content[at : at + 7] = b"\xff" * 7
    return bytes(content)


def test_a_lost_header_is_that_of_another_recording(tmp_path: Path) -> None:
    path, other = tmp_path / "study.xdf", tmp_path / "other.xdf"
    path.write_bytes(_spoilt())
    # Numbers differ from one recording to the next.
    other.write_bytes(
        made.xdf(
            made.stream_header(1, "Strap", channels=3, rate=50.0),
            made.stream_header(7, "Belt", rate=RATE),
            made.samples(7, "float32", VALUES[:1], STAMPS[:1]),
        )
    )
    with pytest.raises(RecordingError) as caught:
        salvage(path, tmp_path / "without.xdf")
    assert caught.value.reason is RecordingReason.EMPTY
    outcome = salvage(path, tmp_path / "with.xdf", other)
    assert rows(tmp_path / "with.xdf")["Belt"] == list(zip(STAMPS, map(tuple, VALUES), strict=True))
    assert any("that of the other recording" in each for each in printing.after_table(outcome))


@pytest.mark.parametrize(
    ("begin", "said"),
    [
        (b"", "it is empty"),
        (b"\0" * 500, "nothing but zeros"),
        (b"0       X X X X", "an EDF file"),
        (b"\xffBIOSEMI", "a BDF file"),
        (b"\n<!DOCTYPE html><html>", "a web page"),
        (b"version https://git-lfs.github.com/spec/v1\noid", "a pointer of Git LFS"),
        (b"#ROSBAG V2.0\n", "a bag of ROS 1"),
        (b"\x89MCAP0\r\n", "a bag of ROS 2"),
        (b"something else", "does not begin with 'XDF:'"),
    ],
)
def test_a_file_that_is_none_is_said_to_be_what_it_is(
    begin: bytes, said: str, tmp_path: Path
) -> None:
    path = tmp_path / "study.xdf"
    path.write_bytes(begin)
    with pytest.raises(RecordingError, match="is no XDF recording") as caught:
        read_recording(path)
    assert caught.value.reason is RecordingReason.NOT_XDF
    assert said in str(caught.value)
