"""Text of numbers: the shortest that is read back as the same number."""

from __future__ import annotations

import math
from decimal import Decimal

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from biosensor_gateway.recording.export.numbers import numbers, rows_of_numbers

FORMATS = ("<f4", "<f8", "<i8", "<i4", "<i2", "i1")


@given(st.sampled_from(FORMATS), st.data())
def test_every_number_is_read_back_as_it_was(dtype: str, data: st.DataObject) -> None:
    shape = st.tuples(st.integers(1, 5), st.integers(1, 4))
    values = data.draw(arrays.arrays(dtype, shape))
    times = data.draw(arrays.arrays("<f8", len(values), elements=st.floats(0, 1e12)))
    lines = rows_of_numbers(times, values).decode().splitlines()
    rows = [line.split(",") for line in lines]
    read = np.dtype(dtype).type
    again = [[read(text) for text in row[1:]] for row in rows]
    np.testing.assert_array_equal(np.array(again, dtype), values)
    assert [float(row[0]) for row in rows] == times.tolist()
    assert [text.decode() for text in numbers(values)] == [text for row in rows for text in row[1:]]


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_a_short_decimal_stays_short(value: float) -> None:
    (text,) = numbers(np.array([value], np.float32))
    assert np.float32(text.decode()) == np.float32(value)
    if value == 0 or 1e-12 < abs(value) < 1e12:
        assert _digits(text.decode()) <= _digits(str(np.float32(value)))


def _digits(text: str) -> int:
    return len(Decimal(text).normalize().as_tuple().digits)


def test_what_is_no_number_can_be_told_apart() -> None:
    values = np.array([[math.nan, math.inf, -math.inf, -0.0]], np.float32)
    assert rows_of_numbers(np.array([0.5]), values) == b"0.5,NaN,inf,-inf,-0.0\n"


def test_integers_of_64_bits_lose_nothing() -> None:
    values = np.array([[2**63 - 1, -(2**63)]])
    assert rows_of_numbers(np.array([1.0]), values) == (
        b"1.0,9223372036854775807,-9223372036854775808\n"
    )
