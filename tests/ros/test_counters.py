"""What became of a stream's samples is counted, estimated or unknown, but never made up."""

from __future__ import annotations

from dataclasses import replace

import pytest

from biosensor_common.refusal import Refusal, Refusals
from lsl_to_ros.statistics.losses import Delays, Losses, Lost, NodeCounters, can_estimate_losses
from tests.rigs.recorded_topics import header_of

ECG = header_of("zephyr", "ecg")
FOREIGN = replace(ECG, foreign=True)


@pytest.mark.parametrize(
    ("lost", "text"),
    [
        (Lost(0, is_estimated=False), "0"),
        (Lost(17, is_estimated=False), "17"),
        (Lost(17, is_estimated=True), "about 17"),
        (Lost(0, is_estimated=True), "about 0"),
        (Lost(-1, is_estimated=False), "unknown"),
    ],
)
def test_a_loss_says_how_certain_it_is(lost: Lost, text: str) -> None:
    assert str(lost) == text


def test_only_gaps_of_another_programs_regular_stream_tell_of_losses() -> None:
    assert can_estimate_losses(FOREIGN)
    assert not can_estimate_losses(replace(FOREIGN, rate=0.0))
    assert not can_estimate_losses(ECG)


def test_the_agents_count_is_better_than_an_estimate_and_that_better_than_nothing() -> None:
    counters = NodeCounters(missing=5)
    assert counters.lost(can_estimate=False) == Lost(-1, is_estimated=False)
    assert counters.lost(can_estimate=True) == Lost(5, is_estimated=True)
    counters.comparison.reported(0, 3, 0.0)
    assert counters.lost(can_estimate=True) == Lost(3, is_estimated=False)


def test_what_lsl_dropped_is_missing() -> None:
    counters = NodeCounters(missing=2)
    counters.connection_ended(5)
    assert (counters.undelivered, counters.missing) == (5, 7)
    assert counters.lost(can_estimate=True) == Lost(7, is_estimated=True)


def test_what_lsl_dropped_is_lost_for_good_when_another_outlet_takes_over() -> None:
    counters = NodeCounters()
    counters.comparison.reported(0, 0, 0.0)
    counters.connection_ended(5)
    counters.outlet_changed()
    assert counters.comparison.losses == Losses(device=0, transport=5)
    assert counters.undelivered == 0
    counters.outlet_changed()
    assert counters.comparison.losses == Losses(device=0, transport=5)


def test_what_lsl_dropped_is_counted_once_by_an_outlet_that_continues() -> None:
    counters = NodeCounters()
    counters.comparison.pulled([1.0])
    counters.comparison.reported(1, 0, 1.0)
    counters.comparison.pulled([2.0])
    assert counters.comparison.losses == Losses(device=0, transport=0)
    # 3.0 came, and LSL dropped it: the outlet has counted it, this node has not.
    counters.connection_ended(1)
    counters.comparison.pulled([4.0])
    counters.comparison.reported(4, 0, 4.0)
    counters.comparison.pulled([5.0])
    assert counters.comparison.losses == Losses(device=0, transport=1)


def test_delays_are_those_since_the_last_look() -> None:
    counters = NodeCounters()
    assert counters.take_delays() == Delays()
    assert Delays().mean is None
    for age in (0.25, 0.5, 0.75):
        counters.delays.add(age)
    delays = counters.take_delays()
    assert (delays.count, delays.mean, delays.longest) == (3, 0.5, 0.75)
    assert counters.take_delays().mean is None
    counters.delays.add(0.125)
    assert counters.take_delays().longest == 0.125


def test_what_does_not_fit_is_counted_and_said_once() -> None:
    said: list[str] = []
    counters = NodeCounters(refusals=Refusals(said.append, "zephyr ecg"))
    counters.refusals.refuse(Refusal.UNFIT, 3, why="300 does not fit into UInt8")
    counters.refusals.refuse(Refusal.UNFIT, 2, why="something else")
    assert counters.unfit == 5
    (sentence,) = said
    for part in ("zephyr ecg", "300 does not fit into UInt8"):
        assert part in sentence
