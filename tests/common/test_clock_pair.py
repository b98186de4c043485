"""Pairs of LSL and unix time in events."""

from __future__ import annotations

import json
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.ros_clock import ClockPair, measure_clock_pair, read_clock_pair


@given(st.floats(0, 1e8), st.integers(0, 2**63 - 1))
def test_a_pair_survives_json(lsl_s: float, unix_ns: int) -> None:
    pair = ClockPair(lsl_s, unix_ns)
    assert read_clock_pair(json.loads(json.dumps(pair.as_facts()))) == pair


def test_both_clocks_are_read_at_one_moment() -> None:
    began_s = time.monotonic()
    pair = measure_clock_pair(time.time_ns, time.monotonic)
    before_ns = time.time_ns()
    now_s = time.monotonic()
    after_ns = time.time_ns()
    assert began_s <= pair.lsl_s <= now_s
    then_ns = pair.unix_ns + (now_s - pair.lsl_s) * 1e9
    assert before_ns - 1e6 <= then_ns <= after_ns + 1e6


@pytest.mark.parametrize(
    "event",
    [
        None,
        [],
        {},
        {"clock": 5},
        {"clock": {"lsl_s": 1.0}},
        {"clock": {"lsl_s": "1", "unix_ns": 1}},
        {"clock": {"lsl_s": float("nan"), "unix_ns": 1}},
        {"clock": {"lsl_s": True, "unix_ns": 1}},
        {"clock": {"lsl_s": 1.0, "unix_ns": 1.5}},
        {"clock": {"lsl_s": 1.0, "unix_ns": -1}},
        {"clock": {"lsl_s": 1.0, "unix_ns": 2**63}},
    ],
)
def test_what_is_no_pair_is_none(event: object) -> None:
    assert read_clock_pair(event) is None
