"""The rate of a stream, as told by one status of the agent after the other."""

from __future__ import annotations

import tracemalloc

import pytest

from biosensor_gateway.agent.rate_meter import RATE_OVER_S, RateMeter


def test_the_rate_is_that_of_the_last_seconds() -> None:
    meter = RateMeter()
    for second in range(100):
        meter.note(250 * second if second < 50 else 12_500 + 125 * (second - 50), float(second))
        rate_hz = meter.rate_hz(float(second))
        if RATE_OVER_S < second < 50:
            assert rate_hz == pytest.approx(250.0)
    assert meter.rate_hz(99.0) == pytest.approx(125.0)


def test_a_stream_whose_rate_nobody_asks_for_costs_no_memory() -> None:
    meter = RateMeter()
    tracemalloc.start()
    try:
        for second in range(50_000):
            meter.note(second, float(second))
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 100_000
