"""What is written of cut and damaged recordings, of headers too, and what is said to be missing."""

from __future__ import annotations

import gzip
import math
import re
import struct
import tracemalloc
from collections.abc import Callable
from itertools import accumulate, pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.salvage.outcome import (
    after_table,
    before_table,
    salvage,
    salvaged_path,
    table,
)
from biosensor_gateway.recording.xdf.verdict import judge
from tests.xdf import xdf_file as made
from tests.xdf.checking import Rows, check, load_by_pyxdf, rows, salvaged

# What is written of cut and damaged recordings, and what is said to be lost.

PARTS = made.two_streams()
WHOLE = b"".join(PARTS)
ENDS = list(accumulate(len(part) for part in PARTS))
NUMBERS: Rows = [(10 + k / 4, (k // 4, k // 4)) for k in range(160)]
EVENTS: Rows = [(10.0 + k, (f"event {k}",)) for k in range(40)]
CASES = settings(max_examples=120, deadline=None)


def _spoilt(*numbers: int) -> bytes:
    """Replace some of the parts by nonsense."""
    return b"".join(b"\xee" * len(p) if n in numbers else p for n, p in enumerate(PARTS))


def _held(parts: list[bytes]) -> dict[str, Rows]:
    """Return the samples of some of the parts, as they are in the undamaged file."""
    blocks = [number for number, part in enumerate(PARTS) if made.is_samples(part, 1)]
    kept = [at for at, number in enumerate(blocks) if PARTS[number] in parts]
    events = [part for part in PARTS if made.is_samples(part, 2)]
    kept_events = [at for at, part in enumerate(events) if part in parts]
    return {
        "numbers": [NUMBERS[4 * at + n] for at in kept for n in range(4)],
        "events": [EVENTS[at] for at in kept_events],
    }


def test_of_the_undamaged_file_everything_is_known(tmp_path: Path) -> None:
    path = tmp_path / "whole.xdf"
    path.write_bytes(WHOLE)
    assert rows(path) == _held(PARTS) == {"numbers": NUMBERS, "events": EVENTS}


def test_joined_recordings_get_a_number_for_each_stream(tmp_path: Path) -> None:
    """Also pyxdf reads all of both then; before, of two streams of one number it reads one."""
    second = [
        made.stream_header(1, "other", channels=1, rate=4.0),
        made.samples(1, "float32", [[5.0]] * 8, [50.0, *[None] * 7]),
        made.clock_offset(1, 50.0, 0.5),
        made.samples(1, "float32", [[6.0]] * 8, [52.0, *[None] * 7]),
        made.footer(1, 16),
    ]
    content = WHOLE + made.xdf(*second)
    found = salvaged(content, tmp_path)
    read = {each["info"]["name"][0]: each for each in load_by_pyxdf(found.file)}
    assert {name: len(each["time_stamps"]) for name, each in read.items()} == {
        "numbers": 160,
        "events": 40,
        "other": 16,
    }
    assert read["other"]["time_series"][:, 0].tolist() == [5.0] * 8 + [6.0] * 8
    assert any("other: it got the new number" in each for each in after_table(found.outcome))


def test_a_whole_recording_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "study.xdf"
    path.write_bytes(WHOLE)
    outcome = salvage(path, salvaged_path(path))
    assert (outcome.written, outcome.lost_bytes) == (None, 0)
    assert [each.name for each in tmp_path.iterdir()] == ["study.xdf"]
    (sentence,) = before_table(outcome)
    assert "is whole" in sentence


def test_a_stream_that_labrecorder_never_closes_is_no_damage(tmp_path: Path) -> None:
    path = tmp_path / "study.xdf"
    path.write_bytes(
        b"".join([*PARTS[:-2], made.stream_header(3, "big", fmt="int64"), *PARTS[-2:]])
    )
    assert salvage(path, salvaged_path(path)).written is None


@CASES
@given(st.integers(0, len(WHOLE) - 1))
def test_cut_at_any_byte(end: int) -> None:
    whole = [part for part, until in zip(PARTS, ENDS, strict=True) if until <= end]
    with TemporaryDirectory() as folder:
        if end < ENDS[4]:
            with pytest.raises(RecordingError) as caught:
                salvaged(WHOLE[:end], Path(folder))
            is_empty = end >= len("XDF:")
            expected = RecordingReason.EMPTY if is_empty else RecordingReason.NOT_XDF
            assert caught.value.reason is expected
            return
        outcome, file, content = salvaged(WHOLE[:end], Path(folder))
        assert rows(file) == _held(whole)
        # What was whole comes first, unchanged.
        assert content.startswith(b"".join(whole))
        assert outcome.lost_bytes == end - sum(map(len, whole))


def test_any_lost_chunk_costs_itself_only(tmp_path: Path) -> None:
    for number in range(4, len(PARTS)):
        folder = tmp_path / str(number)
        folder.mkdir()
        outcome, file, content = salvaged(_spoilt(number), folder)
        others = [part for at, part in enumerate(PARTS) if at != number]
        assert rows(file) == _held(others)
        (place,) = outcome.places
        assert (place.damage.start, place.damage.end) == (ENDS[number - 1], ENDS[number])
        assert outcome.lost_bytes == len(PARTS[number])
        assert content.startswith(b"".join(PARTS[: number - 1]))


@CASES
@given(st.integers(ENDS[3], len(WHOLE) - 1), st.integers(1, 255))
def test_a_changed_byte_costs_one_chunk_at_most(place: int, change: int) -> None:
    content = bytearray(WHOLE)
    content[place] ^= change
    hit = next(number for number, end in enumerate(ENDS) if place < end)
    others = _held([part for at, part in enumerate(PARTS) if at != hit])
    with TemporaryDirectory() as folder:
        path = Path(folder) / "study.xdf"
        path.write_bytes(content)
        outcome = salvage(path, salvaged_path(path))
        found = rows(outcome.written or path)
    for name, kept in others.items():
        # A changed stamp or value is nothing that anybody can see, and moves what has no stamp.
        values = [value for _, value in found[name]]
        assert all(values.count(value) >= 1 for _, value in kept)


@CASES
@given(st.integers(4, len(WHOLE)), st.integers(0, 400), st.binary(max_size=200))
def test_whatever_is_replaced_the_result_is_whole(start: int, gone: int, garbage: bytes) -> None:
    with TemporaryDirectory() as folder:
        path, again = Path(folder) / "study.xdf", Path(folder) / "again.xdf"
        path.write_bytes(WHOLE[:start] + garbage + WHOLE[start + gone :])
        try:
            outcome = salvage(path, salvaged_path(path))
        except RecordingError as error:
            assert error.reason is RecordingReason.EMPTY
            return
        assert outcome.written is None or salvage(outcome.written, again).written is None


def test_where_the_stream_goes_on_without_a_stamp_it_gets_one(tmp_path: Path) -> None:
    stamps = [None, 21.5, None, None]
    head = made.stream_header(1, "a", rate=2.0, created_at=5.0)
    lost = made.samples(1, "float32", [[0]] * 4, [12.0, None, None, None])
    parts = [
        made.samples(1, "float32", [[k] for k in range(4)], [10.0, None, None, None]),
        b"\xee" * len(lost),
        # Two chunks without a stamp, and one that has its first late.
        made.samples(1, "float32", [[8], [9]], [None, None]),
        made.samples(1, "float32", [[10]], [None]),
        made.samples(1, "float32", [[k] for k in range(11, 15)], stamps),
    ]
    outcome, file, content = salvaged(made.xdf(head, *parts), tmp_path)
    assert content.count(parts[-1]) == content.count(parts[-2]) == 1
    # The sample at 21.5 s is the fifth behind the damage.
    before = [(10 + k / 2, (k,)) for k in range(4)]
    assert rows(file)["a"] == before + [(19.5 + k / 2, (8 + k,)) for k in range(7)]
    (place,) = outcome.places
    assert (place.begin_s, place.end_s) == (1.5, 9.5)
    assert table(outcome) == [("a", "11", "at least 15")]
    assert "a: the timestamps after 1 of the damaged places" in "\n".join(after_table(outcome))


def test_a_stream_that_lost_nothing_keeps_every_byte(tmp_path: Path) -> None:
    lost = made.samples(2, "string", [["gone"]], [11.0])
    parts = [
        made.stream_header(1, "a", rate=2.0, created_at=5.0),
        made.stream_header(2, "b", fmt="string", created_at=5.0),
        made.samples(1, "float32", [[0], [1]], [10.0, None]),
        b"\xee" * len(lost),
        made.samples(1, "float32", [[2], [3]], [None, 11.52]),
    ]
    outcome, file, content = salvaged(made.xdf(*parts), tmp_path)
    assert [stamp for stamp, _ in rows(file)["a"]] == [10.0, 10.5, 11.0, 11.52]
    assert parts[-1] in content
    assert table(outcome) == [("a", "4", "not known"), ("b", "0", "not known")]


def test_samples_that_can_get_no_stamp_are_said(tmp_path: Path) -> None:
    parts = [
        made.stream_header(1, "a", rate=2.0, created_at=5.0),
        made.samples(1, "float32", [[0]], [10.0]),
        b"\xee" * 50,
        made.samples(1, "float32", [[1], [2]], [None, None]),
    ]
    outcome, file, _ = salvaged(made.xdf(*parts), tmp_path)
    assert len(rows(file)["a"]) == 3
    assert "a: 2 samples after damaged bytes have no timestamp" in "\n".join(after_table(outcome))


def test_a_stream_without_its_header_is_left_out_and_named(tmp_path: Path) -> None:
    header = bytearray(PARTS[2])
    header[-2] = 0
    content = b"".join([*PARTS[:2], bytes(header), *PARTS[3:]])
    outcome, file, _ = salvaged(content, tmp_path)
    assert rows(file) == {"events": EVENTS}
    orphans = outcome.survey.orphans[1]
    left = [part for part in PARTS[3:] if part[7:11] == b"\1\0\0\0"]
    assert (orphans.name, orphans.chunks) == ("numbers", len(left))
    assert orphans.bytes == sum(map(len, left))
    (said, *_) = after_table(outcome)
    assert said.startswith("left out: stream number 1 (numbers), ")
    assert outcome.lost_bytes == orphans.bytes + len(header)


def test_a_lost_file_header_is_made_again(tmp_path: Path) -> None:
    _, file, content = salvaged(_spoilt(1), tmp_path)
    assert rows(file) == {"numbers": NUMBERS, "events": EVENTS}
    assert content[4:].startswith(b"\x01")
    assert b"<version>1.0</version>" in content


def test_footers_are_those_of_the_recorder_or_say_what_is_there(tmp_path: Path) -> None:
    block = next(n for n, part in enumerate(PARTS) if n > 20 and made.is_samples(part, 1))
    outcome, file, content = salvaged(_spoilt(block), tmp_path)
    assert table(outcome) == [("numbers", "156", "4"), ("events", "40", "0")]
    # That of the events still holds.
    assert PARTS[-1] in content
    assert PARTS[-2] not in content
    numbers, _ = load_by_pyxdf(file)
    footer = numbers["footer"]["info"]
    assert footer["sample_count"] == ["156"]
    assert float(footer["first_timestamp"][0]) == 10.0
    assert float(footer["last_timestamp"][0]) == NUMBERS[-1][0]
    offsets = footer["clock_offsets"][0]["offset"]
    assert [float(each["time"][0]) for each in offsets] == numbers["clock_times"]
    assert [float(each["value"][0]) for each in offsets] == numbers["clock_values"]


def test_the_time_of_a_loss_is_told(tmp_path: Path) -> None:
    blocks = [n for n, part in enumerate(PARTS) if made.is_samples(part, 1)]
    content = _spoilt(*range(blocks[10], blocks[15]), blocks[20])[: ENDS[-3] - 3]
    outcome, _, _ = salvaged(content, tmp_path)
    times = [(place.begin_s, place.end_s) for place in outcome.places]
    nothing_after = math.nan
    # On the recorder's clock, which is a millisecond ahead of that of the numbers.
    expected = [(9.751, 15.001), (19.751, 21.001), (39.751, nothing_after)]
    assert times == [pytest.approx(each, nan_ok=True) for each in expected]
    said = list(before_table(outcome))
    assert "between 9.8 and 15.0 s" in said[1]
    assert "after 39.8 s" in said[-1]


def test_many_places_are_not_all_listed(tmp_path: Path) -> None:
    content = _spoilt(*(n for n, part in enumerate(PARTS) if made.is_samples(part, 1) and n % 4))
    outcome, _, _ = salvaged(content, tmp_path)
    said = list(before_table(outcome))
    assert len(outcome.places) > 10
    assert said[-1] == f"  and {len(outcome.places) - 10} more"


def test_a_compressed_recording_is_salvaged_to_a_plain_one(tmp_path: Path) -> None:
    packed = gzip.compress(WHOLE)
    _, file, _ = salvaged(packed[: len(packed) * 3 // 4], tmp_path, "study.xdf.gz")
    assert file.name == "study_salvaged.xdf"
    found = rows(file)
    assert found["numbers"] == NUMBERS[: len(found["numbers"])]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("a.b.xdf", "a.b_salvaged.xdf"),
        ("a.XDF", "a_salvaged.xdf"),
        ("a.xdfz", "a_salvaged.xdf"),
        ("a", "a_salvaged.xdf"),
        ("a.dat", "a.dat_salvaged.xdf"),
    ],
)
def test_its_name(name: str, expected: str) -> None:
    assert salvaged_path(Path("/data") / name) == Path("/data") / expected


def test_a_large_file_needs_little_memory(tmp_path: Path) -> None:
    path = tmp_path / "study.xdf"
    stamps = [10 + k / 1000 for k in range(5000)]
    with path.open("wb") as file:
        file.write(made.xdf(made.stream_header(1, "a", rate=1000.0)))
        block = made.samples(1, "float32", [[1.0]] * 5000, stamps)
        for _ in range(300):
            file.write(block)
        file.write(block[:-1])
    tracemalloc.start()
    salvage(path, salvaged_path(path))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert path.stat().st_size > 19_000_000
    assert peak < 4_000_000


def test_places_in_the_file_follow_each_other(tmp_path: Path) -> None:
    outcome, _, _ = salvaged(_spoilt(10, 20, 21, 40), tmp_path)
    ends = [(each.damage.start, each.damage.end) for each in outcome.places]
    assert len(ends) == 3
    assert all(before[1] <= after[0] for before, after in pairwise(ends))


@pytest.mark.parametrize("chunk", [1, 50, 300])
def test_a_last_sample_of_another_time_is_cut_off(chunk: int, tmp_path: Path) -> None:
    stamps = [5000.0 + each / 130 for each in range(300)] + [805030.5]
    values = [[float(each)] for each in range(301)]
    parts = [
        made.samples(1, "float32", values[at : at + chunk], stamps[at : at + chunk])
        for at in range(0, 301, chunk)
    ]
    header = made.stream_header(1, "Polar", kind="ECG", rate=130.0)
    path = tmp_path / "garbage.xdf"
    path.write_bytes(made.xdf(header, *parts, made.footer(1, 300)))
    assert judge(read_recording(path)).can_be_salvaged
    written = tmp_path / "fixed.xdf"
    outcome = salvage(path, written)
    (stream,) = read_recording(written).streams
    assert stream.stamps.tolist() == stamps[:300]
    assert stream.footer is not None
    assert stream.footer.sample_count == 300
    assert any("cut off" in each for each in after_table(outcome))
    assert salvage(written, tmp_path / "again.xdf").survey.is_whole


def test_a_good_last_sample_behind_a_wrong_stamp_stays(tmp_path: Path) -> None:
    stamps = [5000.0 + each / 130 for each in range(300)]
    stamps[-2] = 805030.5
    header = made.stream_header(1, "Polar", kind="ECG", rate=130.0)
    rows = made.samples(1, "float32", [[float(each)] for each in range(300)], stamps)
    path, written = tmp_path / "garbage.xdf", tmp_path / "fixed.xdf"
    # It lacks its footer.
    path.write_bytes(made.xdf(header, rows))
    salvage(path, written)
    (stream,) = read_recording(written).streams
    assert stream.stamps.tolist() == stamps
    assert salvage(written, tmp_path / "again.xdf").survey.is_whole


# Headers of a wrong form are fixed, and lost ones are taken from another recording.
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
    "another language's format": (_replaced("float32", "float"), "channel_format 'float'"),
    "CDATA, and a comma": (
        lambda xml: _replaced("<hostname>host", "<hostname><![CDATA[R&D <1>]]>")(
            _replaced("130.0", "130,0")(xml)
        ),
        "a CDATA section",
    ),
    "a unit": (_replaced("130.0", "130.0 Hz"), "nominal_srate '130.0 Hz'"),
    "an entity of HTML": (_replaced("<hostname>host", "<hostname>&micro;V&nbsp;1"), "entities"),
    "an entity of a document type": (
        lambda xml: (
            '<!DOCTYPE info [<!ENTITY dev "x">]>'
            + _replaced("<hostname>host", "<hostname>&dev;")(xml)
        ),
        "entities",
    ),
    "a namespace": (_replaced("<info>", '<info xmlns="http://example.org/lsl">'), "namespaces"),
    "prefixes": (
        lambda xml: re.sub("<(/?)(?=[a-z])", r"<\1lsl:", xml).replace(
            "<lsl:info>", '<lsl:info xmlns:lsl="urn:lsl" lsl:version="1">'
        ),
        "namespaces",
    ),
    "prefixes that are declared nowhere": (
        _replaced("<type>", '<type xsi:nil="false">'),
        "namespaces",
    ),
    "no number of channels, but descriptions": (
        lambda xml: _replaced(
            "<desc />", "<desc><channels><channel><label>a</label></channel></channels></desc>"
        )(_replaced("<channel_count>1", "<channel_count>0")(xml)),
        "channel_count '0'",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_header_of_a_wrong_form_costs_no_sample(name: str, tmp_path: Path) -> None:
    change, told = WRONG[name]
    # The check says where to go on.
    assert check(_broken(change)).can_be_salvaged
    outcome, file, _ = salvaged(_broken(change), tmp_path)
    assert rows(file)["Belt"] == list(zip(STAMPS, map(tuple, VALUES), strict=True))
    (sentence,) = (each for each in after_table(outcome) if "was fixed" in each)
    assert told in sentence
    assert not outcome.lost_bytes


def test_text_that_looks_like_xml_is_kept(tmp_path: Path) -> None:
    text = "a:b=c, R&D, http://x:80"
    change = _replaced("<hostname>host", f"<hostname><![CDATA[{text}]]>")
    (stream,) = read_recording(
        salvaged(_broken(lambda xml: f"{change(xml)}\0"), tmp_path)[1]
    ).streams
    assert stream.header.hostname == text


def test_cdata_is_xml_and_costs_nothing() -> None:
    report = check(_broken(_replaced("<hostname>host", "<hostname><![CDATA[R&D <1>]]>")))
    assert report.is_good
    (stream,) = report.recording.streams
    assert (stream.header.hostname, stream.sample_count) == ("R&D <1>", COUNT)


def test_a_stream_without_a_rate_is_irregular_then(tmp_path: Path) -> None:
    content = _broken(_replaced("<nominal_srate>130.0</nominal_srate>", ""))
    outcome, file, _ = salvaged(content, tmp_path)
    (stream,) = read_recording(file).streams
    assert (stream.header.rate, stream.sample_count) == (0.0, COUNT)
    assert any("no nominal_srate" in each for each in after_table(outcome))


def _with_header() -> bytes:
    """A recording whose header cannot be read any more, but for its number and name."""
    content = bytearray(made.xdf(GOOD, BODY))
    at = content.index(b"</info>", content.index(b"Belt"))
    content[at : at + 7] = b"\xff" * 7
    return bytes(content)


def test_a_lost_header_is_that_of_another_recording(tmp_path: Path) -> None:
    path, other = tmp_path / "study.xdf", tmp_path / "other.xdf"
    path.write_bytes(_with_header())
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
    assert any("is the other recording's" in each for each in after_table(outcome))


@pytest.mark.parametrize(
    ("begin", "said"),
    [
        (b"", "it is empty"),
        (b"\0" * 500, "only zeros"),
        (b"0       X X X X", "an EDF file"),
        (b"\xffBIOSEMI", "a BDF file"),
        (b"\n<!DOCTYPE html><html>", "a web page"),
        (b"version https://git-lfs.github.com/spec/v1\noid", "a pointer of Git LFS"),
        (b"#ROSBAG V2.0\n", "a bag of ROS 1"),
        (b"\x89MCAP0\r\n", "a bag of ROS 2"),
        (b"%PDF-1.7", "a PDF document"),
        (b"time,ECG\r\n0.1,23.5\r\n", "a text, such as a table"),
        (b"\xef\xbb\xbfXDF:\x01", "saved it as text"),
        (b"\x00\x01 something else", "does not start with 'XDF:'"),
    ],
)
def test_a_file_that_is_none_is_said_to_be_what_it_is(
    begin: bytes, said: str, tmp_path: Path
) -> None:
    path = tmp_path / "study.xdf"
    path.write_bytes(begin)
    with pytest.raises(RecordingError, match="is not an XDF recording") as caught:
        read_recording(path)
    assert caught.value.reason is RecordingReason.NOT_XDF
    assert said in str(caught.value)
