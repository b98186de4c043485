"""What lines and records of bytes mean, and what is said of those that mean nothing."""

from __future__ import annotations

import json
import struct
from itertools import pairwise
from math import isnan
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.line_sensor.driver import row_protocol
from biosensor_gateway.devices.line_sensor.driver.protocol import (
    CHECKSUMS,
    MAX_LINE_BYTES,
    BadLine,
    Flaw,
    Row,
)
from biosensor_gateway.devices.line_sensor.simulator import crc16
from tests.line_sensor.conftest import line_settings

NUMBERS = st.floats(allow_nan=False, allow_infinity=False, width=32)
ROWS = st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=20)
FORM = {"format": "struct", "struct_format": "<ff", "frame_start": "aa55"}


def read(data: bytes, **fields: Any) -> list[Row | BadLine]:
    return row_protocol(line_settings(**fields)).feed(data)


def cut(data: bytes, places: list[int]) -> list[bytes]:
    ends = sorted({0, *(place % (len(data) + 1) for place in places), len(data)})
    return [data[a:b] for a, b in pairwise(ends)]


def rows_of(pieces: list[bytes], **fields: Any) -> list[Row]:
    protocol = row_protocol(line_settings(**fields))
    found = [each for piece in pieces for each in protocol.feed(piece)]
    return [each for each in found if not isinstance(each, BadLine)]


PLACES = st.lists(st.integers(0, 10_000), max_size=8)
SEPARATORS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": "  "}


@given(ROWS, PLACES, st.sampled_from(sorted(SEPARATORS)), st.sampled_from(["\n", "\r\n"]))
def test_values_come_back_from_csv_however_it_is_cut(
    rows: list[Row], places: list[int], separator: str, end: str
) -> None:
    between = SEPARATORS[separator]
    text = "".join(between.join(map(repr, row)) + end for row in rows)
    assert rows_of(cut(text.encode(), places), separator=separator) == rows


@given(ROWS, PLACES, st.sampled_from(["flat", "inside", "array"]))
def test_values_come_back_from_json(rows: list[Row], places: list[int], form: str) -> None:
    def said(row: Row) -> object:
        if form == "array":
            return list(row)
        flat = dict(zip(("x", "y"), row, strict=True))
        return {"data": flat, "other": "text"} if form == "inside" else flat

    text = "".join(json.dumps(said(row)) + "\n" for row in rows)
    assert rows_of(cut(text.encode(), places), format="json") == rows


@pytest.mark.parametrize("separator", sorted(SEPARATORS))
def test_values_may_follow_their_labels_as_for_arduinos_plotter(separator: str) -> None:
    between = SEPARATORS[separator]
    lines = [between.join(each) for each in (("x:1.5", "y:-2"), ("3", "y:4"), ("y:5", "x:6"))]
    first, second, wrong = read(
        "".join(f"{each}\n" for each in lines).encode(), separator=separator
    )
    assert (first, second) == ((1.5, -2.0), (3.0, 4.0))
    # A value of another column is no value of this one.
    assert isinstance(wrong, BadLine)


@given(ROWS, PLACES, st.sampled_from(sorted(CHECKSUMS)), st.binary(max_size=9))
def test_values_come_back_from_records_behind_other_bytes(
    rows: list[Row], places: list[int], checksum: str, noise: bytes
) -> None:
    code, sum_of = CHECKSUMS[checksum]
    values = [struct.pack("<ff", *row) for row in rows]
    records = [b"\xaa\x55" + each + struct.pack(f"<{code}", *([sum_of(each)] if code else []))
               for each in values]  # fmt: skip
    # A beginning in the noise would be taken for one where no checksum says otherwise.
    data = noise.replace(b"\xaa", b"") + b"".join(records)
    assert rows_of(cut(data, places), **FORM, checksum=checksum) == rows


@given(st.binary(max_size=60))
def test_the_checksum_is_the_one_that_its_document_describes(data: bytes) -> None:
    assert CHECKSUMS["crc16"][1](data) == crc16(data)


def test_the_checksum_has_its_published_check_value() -> None:
    # Of the catalogue of CRC algorithms, CRC-16/IBM-3740.
    assert CHECKSUMS["crc16"][1](b"123456789") == 0x29B1


@given(st.integers(2, 9), st.integers(0, 7))
def test_a_flipped_bit_costs_one_record(at: int, bit: int) -> None:
    values = [struct.pack("<ff", number, number) for number in range(3)]
    records = [b"\xaa\x55" + each + struct.pack("<H", crc16(each)) for each in values]
    damaged = bytearray(records[1])
    damaged[at] ^= 1 << bit
    found = read(records[0] + bytes(damaged) + records[2], **FORM, checksum="crc16")
    assert [each for each in found if not isinstance(each, BadLine)] == [(0.0, 0.0), (2.0, 2.0)]
    (bad,) = [each for each in found if isinstance(each, BadLine)]
    assert (bad.flaw, bad.size) == (Flaw.CHECKSUM, len(damaged))


@pytest.mark.parametrize("value", ["", "nan", "NaN", "inf", "-inf", "ovf", "1e999"])
def test_no_value_is_no_number_and_no_mistake(value: str) -> None:
    ((x, y),) = rows_of([f"{value},2\n".encode()])
    assert isnan(x)
    assert y == 2


def test_comments_headings_and_empty_lines_mean_nothing() -> None:
    assert read(b"# board 1.2\n\r\nx,y\n1,2\n") == [(1.0, 2.0)]


def test_other_columns_are_passed_over() -> None:
    fields = {"columns": ["x", "-", "y"]}
    assert read(b"1,?!,2\n", **fields) == [(1.0, 0.0, 2.0)]
    assert read(b'{"x":1,"y":null,"z":"a"}\n', **fields, format="json")[0][0] == 1.0  # type: ignore[index]


def test_decimal_commas_are_read_where_they_separate_nothing() -> None:
    assert read(b"1,5;-2,25\n", separator="semicolon") == [(1.5, -2.25)]


@pytest.mark.parametrize(
    ("data", "fields", "flaw", "words"),
    [
        (b"1,2,3\n", {}, Flaw.COUNT, "has 3 values between commas, but columns names 2"),
        (b"1;2\n", {}, Flaw.COUNT, 'it has as many with separator = "semicolon"'),
        (b'{"x":1,"y":2,"z":3}\n', {}, Flaw.COUNT, 'it looks like format = "json"'),
        (b"1,one\n", {}, Flaw.NOT_A_NUMBER, "has 'one' in column y, which is not a number"),
        (b"1,1_0\n", {}, Flaw.NOT_A_NUMBER, "in column y"),
        (b"1,\xc3\xa9\n", {}, Flaw.NOT_TEXT, "is no text"),
        (b"1" * 5000 + b"\n", {}, Flaw.TOO_LONG, "is longer than 4096"),
        (b"1,2\n", {"format": "json"}, Flaw.NOT_JSON, 'is it format = "csv"?'),
        (b"7\n", {"format": "json"}, Flaw.NOT_JSON, "neither"),
        (b'{"X":1}\n', {"format": "json"}, Flaw.NO_KEYS, "has no key x, y; its keys are 'X'"),
        (b'{"x":"1"}\n', {"format": "json"}, Flaw.NOT_A_NUMBER, "no number in x"),
        (b"[1]\n", {"format": "json"}, Flaw.COUNT, "has 1 values"),
        (b"[" * 3000 + b"\n", {"format": "json"}, Flaw.NOT_JSON, "no JSON"),
        (b"\x00" * 10, FORM, Flaw.NO_FRAME, "starts with aa55"),
    ],
)
def test_a_line_that_does_not_fit_says_why_and_does_no_harm(
    data: bytes, fields: dict[str, Any], flaw: Flaw, words: str
) -> None:
    (bad,) = row_protocol(line_settings(**fields)).feed_whole(data)
    assert isinstance(bad, BadLine)
    assert (bad.flaw, bad.size) == (flaw, len(data))
    assert words in bad.why


def test_of_a_line_that_never_ends_only_its_length_is_kept() -> None:
    protocol = row_protocol(line_settings())
    for _ in range(20):
        assert protocol.feed(b"1" * 1000) == []
        assert protocol.buffered <= MAX_LINE_BYTES
    bad, row = protocol.feed(b"\n1,2\n")
    assert isinstance(bad, BadLine)
    assert (bad.flaw, bad.size) == (Flaw.TOO_LONG, 20_001)
    assert row == (1.0, 2.0)


@given(st.binary(max_size=200), st.sampled_from(["csv", "json"]))
def test_any_bytes_are_rows_or_bad_lines(data: bytes, form: str) -> None:
    for each in read(data + b"\n", format=form):
        if isinstance(each, BadLine):
            assert 0 < each.size <= len(data) + 1
        else:
            assert len(each) == 2


def test_a_needed_value_must_be_there() -> None:
    fields = {"columns": ["n", "x"], "sequence_column": "n"}
    (bad,) = read(b",2\n", **fields)
    assert isinstance(bad, BadLine)
    assert "column n" in bad.why
    (bad,) = read(b'{"x":1}\n', **fields, format="json")
    assert isinstance(bad, BadLine)
    assert "no key n" in bad.why


def test_the_first_line_of_a_port_may_be_half_of_one() -> None:
    assert read(b"5,6\n7,8\n", port="COM1") == [(7.0, 8.0)]


def test_a_message_ends_with_its_last_line() -> None:
    protocol = row_protocol(line_settings())
    assert protocol.feed_whole(b"1,2\n3,4") == [(1.0, 2.0), (3.0, 4.0)]


@pytest.mark.parametrize(
    ("line", "separator", "row"),
    [
        (b"x:1,y:-2.5\n", "comma", (1.0, -2.5)),
        (b"x: 1\ty: 2\n", "tab", (1.0, 2.0)),
        (b"x:1, y:\n", "comma", (1.0, None)),
    ],
)
def test_values_behind_their_labels_are_read(
    line: bytes, separator: str, row: tuple[float | None, ...]
) -> None:
    (found,) = read(line, separator=separator, port=None, udp_port=5005)
    assert not isinstance(found, BadLine)
    assert [None if isnan(each) else each for each in found] == list(row)


def test_a_value_behind_another_label_is_refused() -> None:
    (found,) = read(b"x:1,z:2\n", port=None, udp_port=5005)
    assert isinstance(found, BadLine)
    assert found.flaw is Flaw.NOT_A_NUMBER
