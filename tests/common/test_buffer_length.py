"""How much an inlet buffers: so long, unless somebody announces an absurd rate."""

from __future__ import annotations

import pytest

from biosensor_common.lsl.inlet import MOST_BUFFERED, buffer_length


@pytest.mark.parametrize("rate", [0.0, 0.5, 1.0, 256.0, MOST_BUFFERED / 121])
def test_a_usual_stream_is_buffered_for_so_long(rate: float) -> None:
    assert buffer_length(rate, 120) == 120


@pytest.mark.parametrize("rate", [MOST_BUFFERED / 119, 1e5, 1e6, 1e9])
def test_no_rate_takes_more_memory_than_the_bound_or_a_second(rate: float) -> None:
    length = buffer_length(rate, 120)
    assert 1 <= length < 120
    assert length * rate <= max(MOST_BUFFERED, rate)
    assert buffer_length(rate, 10, 200_000) <= length
