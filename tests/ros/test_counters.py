"""What became of a stream's samples: counted, estimated or lost, and where gaps are."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biosensor_common.lsl.inlet import Stamps
from biosensor_common.refusal import Refusal, Refusals
from lsl_to_ros.statistics.losses import (
    FOREIGN_JITTER_S,
    GAP_PERIODS,
    CountersComparison,
    Delays,
    Gap,
    GapFinder,
    Losses,
    Lost,
    NodeCounters,
    can_estimate_losses,
)
from tests.rigs.recorded_topics import header_of
from tests.xdf.test_pace import BURST, NOMINAL_HZ, bursts, delays, overlaps, without

# What became of a stream's samples is counted, estimated or unknown, but never made up.

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


# The node's count of lost samples is exact, however samples and reports are interleaved.
class Push(NamedTuple):
    """Samples pushed with one stamp: for each, whether it arrives."""

    arrives: list[bool]


class Report(NamedTuple):
    lost: int


class Deliver(NamedTuple):
    samples: int
    reports: int


events = st.lists(
    st.one_of(
        st.builds(Push, st.lists(st.booleans(), min_size=1, max_size=5)),
        st.builds(Report, st.integers(0, 3)),
        st.builds(Deliver, st.integers(0, 10), st.integers(0, 3)),
    ),
    max_size=60,
)


class Link:
    """An agent that pushes and reports over two connections that do not wait for each other."""

    def __init__(self, pushed_before: int) -> None:
        self.comparison = CountersComparison()
        self.dropped = 0
        self.lost = 0
        self._pushed = pushed_before
        self._stamp = float(pushed_before)
        self._samples: deque[float] = deque()
        self._reports: deque[tuple[int, int, float]] = deque()

    def push(self, arrives: list[bool]) -> None:
        self._stamp += 1.0
        self._pushed += len(arrives)
        self.dropped += arrives.count(False)
        self._samples.extend([self._stamp] * arrives.count(True))

    def pushed_unattached(self, count: int) -> None:
        """Push samples while nobody is there."""
        self._pushed += count
        self._stamp += float(count > 0)

    def report(self, lost: int = 0) -> None:
        self.lost += lost
        self._reports.append((self._pushed, self.lost, self._stamp))

    def deliver(self, samples: int, reports: int) -> None:
        count = min(samples, len(self._samples))
        if count:
            self.comparison.pulled([self._samples.popleft() for _ in range(count)])
        for _ in range(min(reports, len(self._reports))):
            self.comparison.reported(*self._reports.popleft())

    def deliver_all(self) -> None:
        self.deliver(len(self._samples), len(self._reports))

    def settle(self) -> None:
        """A report, and a later sample that shows that all before it have come."""
        self.push([True])
        self.report()
        self.push([True])
        self.deliver_all()


@given(pushed_before=st.integers(0, 1000), events=events)
def test_exactly_what_is_missing_is_reported(
    pushed_before: int, events: list[Push | Report | Deliver]
) -> None:
    link = Link(pushed_before)
    link.settle()
    assert link.comparison.losses == Losses(device=0, transport=0)
    for event in events:
        match event:
            case Push(arrives):
                link.push(arrives)
            case Report(lost):
                link.report(lost)
            case Deliver(samples, reports):
                link.deliver(samples, reports)
        losses = link.comparison.losses
        assert losses is not None
        assert 0 <= losses.transport <= link.dropped
        assert 0 <= losses.device <= link.lost
    link.settle()
    assert link.comparison.losses == Losses(device=link.lost, transport=link.dropped)


def test_a_sample_is_lost_whether_before_or_after_the_agent() -> None:
    assert Losses(device=3, transport=4).total == 7


def test_nothing_is_said_before_the_agent_has_said_something() -> None:
    comparison = CountersComparison()
    comparison.pulled([1.0])
    assert comparison.losses is None


def test_a_stream_that_has_pushed_nothing_has_lost_what_the_device_lost() -> None:
    comparison = CountersComparison()
    comparison.reported(0, 7, 0.0)
    assert comparison.losses == Losses(device=7, transport=0)


def test_a_report_waits_for_the_rest_of_its_newest_stamp() -> None:
    link = Link(0)
    link.settle()
    link.push([True, True])
    link.report()
    link.deliver(1, 1)
    assert link.comparison.losses == Losses(device=0, transport=0)
    link.deliver_all()
    assert link.comparison.losses == Losses(device=0, transport=0)


def test_an_idle_stream_still_shows_what_its_device_loses() -> None:
    link = Link(0)
    link.settle()
    link.report(lost=4)
    link.deliver_all()
    assert link.comparison.losses == Losses(device=4, transport=0)


def test_a_report_too_old_to_compare_changes_nothing() -> None:
    link = Link(0)
    link.settle()
    link.push([False])
    link.report()
    for _ in range(5000):
        link.push([True])
    link.deliver(5000, 0)
    link.deliver(0, 1)
    assert link.comparison.losses == Losses(device=0, transport=0)


@given(counts=st.lists(st.integers(1, 3000), min_size=1, max_size=4))
def test_a_report_is_compared_however_many_samples_come_at_once(counts: list[int]) -> None:
    link = Link(0)
    link.settle()
    for count in counts:
        link.push([True] * (count - 1) + [False])
        link.report()
        link.push([True])
        link.deliver_all()
    assert link.comparison.losses == Losses(device=0, transport=len(counts))


def restarted(link: Link, undelivered: int = 0) -> Link:
    """Let the stream come from an outlet that counts from zero."""
    link.comparison.restarted(undelivered)
    again = Link(0)
    again.comparison = link.comparison
    return again


def test_what_was_lost_before_an_agent_started_again_stays_counted() -> None:
    link = Link(0)
    link.settle()
    link.push([False, True])
    link.report(lost=4)
    link.settle()
    again = restarted(link)
    assert again.comparison.losses == Losses(device=4, transport=1)
    again.settle()
    assert again.comparison.losses == Losses(device=4, transport=1)
    again.push([False, True])
    again.report(lost=2)
    again.settle()
    assert again.comparison.losses == Losses(device=6, transport=2)


def test_what_lsl_dropped_when_an_outlet_ended_is_lost_on_the_way() -> None:
    link = Link(0)
    link.settle()
    again = restarted(link, undelivered=5)
    assert again.comparison.losses == Losses(device=0, transport=5)
    again.settle()
    assert again.comparison.losses == Losses(device=0, transport=5)


def test_a_report_of_the_outlet_before_is_not_compared_with_the_new_one() -> None:
    link = Link(0)
    link.settle()
    link.push([False])
    link.report()
    link.deliver_all()
    again = restarted(link)
    again.settle()
    assert again.comparison.losses == Losses(device=0, transport=0)


def test_a_stream_that_is_attached_again_counts_what_it_missed() -> None:
    link = Link(0)
    link.settle()
    # While the node is away; the outlet goes on counting.
    link.push([False] * 7)
    link.settle()
    assert link.comparison.losses == Losses(device=0, transport=7)


def test_what_an_outlet_sends_before_it_is_attached_again_is_lost() -> None:
    link = Link(0)
    link.settle()
    again = restarted(link)
    # The agent has started again, and sends before the node has seen its outlet.
    again.push([False] * 3)
    again.settle()
    assert again.comparison.losses == Losses(device=0, transport=3)


def test_a_report_from_before_the_stream_is_attached_says_nothing_of_what_came_between() -> None:
    link = Link(100)
    link.report()
    link.deliver_all()
    link.pushed_unattached(32)
    link.push([True])
    link.deliver_all()
    assert link.comparison.losses is None
    link.settle()
    assert (link.comparison.before, link.comparison.losses) == (132, Losses(device=0, transport=0))


def test_a_slow_stream_needs_one_report_after_its_first_sample() -> None:
    link = Link(100)
    link.report()
    link.push([True])
    link.report(lost=2)
    link.deliver_all()
    assert (link.comparison.before, link.comparison.losses) == (100, Losses(device=2, transport=0))


@given(counts=st.lists(st.integers(0, 5), max_size=5), events=events)
def test_nothing_that_was_sent_to_nobody_is_ever_lost(
    counts: list[int], events: list[Push | Report | Deliver]
) -> None:
    link = Link(0)
    for count in counts:
        link.pushed_unattached(count)
        link.report()
    link.deliver_all()
    for event in events:
        match event:
            case Push(arrives):
                link.push([True] * len(arrives))
            case Report():
                link.report()
            case Deliver(samples, reports):
                link.deliver(samples, reports)
        assert link.comparison.losses in {None, Losses(device=0, transport=0)}
    link.settle()
    assert link.comparison.before == sum(counts)


def test_what_was_sent_before_the_node_was_there_is_told_and_not_lost() -> None:
    link = Link(7)
    assert link.comparison.before is None
    link.settle()
    assert (link.comparison.before, link.comparison.losses) == (7, Losses(device=0, transport=0))
    again = restarted(link)
    again.settle()
    assert again.comparison.before == 7


# Gaps are found by the stamps, which may be anything, and in whatever blocks they come.
RATE = 100.0
PERIOD = 1 / RATE
# Times of a sender: neighbours, jitter, gaps, and steps back.
steps = st.one_of(
    st.just(PERIOD), st.floats(-0.05, 0.05), st.floats(0.0, 5.0), st.floats(-5.0, 0.0)
)
times = st.lists(steps, min_size=1, max_size=60).map(
    lambda all_: [*accumulate(all_, initial=1000.0)]
)
# What another program may write instead of a time.
nonsense = st.sampled_from([math.nan, math.inf, -math.inf])
mixed = times.flatmap(
    lambda stamps: st.tuples(*(st.just(stamp) | nonsense for stamp in stamps)).map(list)
)
rates = st.sampled_from([0.0, 4.0, RATE, 1e6])
cuts = st.lists(st.integers(1, 60), max_size=10)


def spaced(count: int, step: float) -> Stamps:
    return np.array([2.0 + number * step for number in range(count)])


def one_at_a_time(finder: GapFinder, stamps: list[float]) -> list[Gap]:
    found: list[Gap] = []
    for place, stamp in enumerate(stamps):
        found += [Gap(place, gap.missing) for gap in finder.find(np.array([stamp]))]
    return found


def in_blocks(finder: GapFinder, stamps: list[float], cut: list[int]) -> list[Gap]:
    found: list[Gap] = []
    edges = sorted({0, len(stamps), *(place for place in cut if place < len(stamps))})
    for start, end in pairwise(edges):
        gaps = finder.find(np.array(stamps[start:end]))
        found += [Gap(start + gap.place, gap.missing) for gap in gaps]
    return found


def compare(stamps: list[float], cut: list[int], rate: float, *, foreign: bool) -> None:
    singly, together = (GapFinder(rate, foreign=foreign) for _ in range(2))
    assert in_blocks(together, stamps, cut) == one_at_a_time(singly, stamps)
    assert together.last_stamp == singly.last_stamp


@settings(deadline=None)
@given(stamps=times, cut=cuts, rate=rates, foreign=st.booleans())
def test_one_at_a_time_and_in_blocks_give_the_same(
    stamps: list[float], cut: list[int], rate: float, foreign: bool
) -> None:
    compare(stamps, cut, rate, foreign=foreign)


@settings(deadline=None)
@given(stamps=mixed, cut=cuts, rate=rates, foreign=st.booleans())
def test_so_do_stamps_that_are_no_times(
    stamps: list[float], cut: list[int], rate: float, foreign: bool
) -> None:
    compare(stamps, cut, rate, foreign=foreign)


@settings(deadline=None)
@given(
    stamps=st.lists(st.floats(width=64), min_size=1, max_size=20),
    cut=cuts,
    rate=st.sampled_from([0.0, 1e-300, RATE, 1e6]),
)
def test_so_does_any_number(stamps: list[float], cut: list[int], rate: float) -> None:
    compare(stamps, cut, rate, foreign=True)


@settings(deadline=None)
@given(missing=st.lists(st.integers(0, 1000), min_size=1, max_size=30), rate=st.floats(1.0, 1000.0))
def test_what_is_missing_is_counted(missing: list[int], rate: float) -> None:
    numbers = accumulate((1 + count for count in missing), initial=0)
    stamps = np.array([5000.0 + number / rate for number in numbers])
    gaps = GapFinder(rate, foreign=False).find(stamps)
    expected = [Gap(place, count) for place, count in enumerate(missing, 1) if count]
    assert gaps == expected


def test_the_first_sample_ever_comes_after_no_gap() -> None:
    assert GapFinder(RATE, foreign=False).find(np.array([7.0])) == []
    assert GapFinder(RATE, foreign=False).find(np.array([7.0, 7.01])) == []


def test_between_two_blocks_there_can_be_a_gap() -> None:
    finder = GapFinder(RATE, foreign=False)
    finder.find(np.array([1.0, 1.01]))
    assert finder.find(np.array([1.06, 1.07])) == [Gap(0, 4)]
    assert finder.find(np.array([1.12])) == [Gap(0, 4)]


def test_a_stamp_that_is_a_little_late_is_no_gap() -> None:
    late = spaced(10, PERIOD * GAP_PERIODS * 0.99)
    assert GapFinder(RATE, foreign=False).find(late) == []
    too_late = spaced(3, PERIOD * GAP_PERIODS * 1.01)
    assert [gap.place for gap in GapFinder(RATE, foreign=False).find(too_late)] == [1, 2]


def test_stamps_of_other_programs_may_jitter() -> None:
    jitter = spaced(10, FOREIGN_JITTER_S * 0.99)
    assert GapFinder(RATE, foreign=True).find(jitter) == []
    assert len(GapFinder(RATE, foreign=False).find(jitter)) == 9
    assert GapFinder(RATE, foreign=True).find(np.array([1.0, 1.2])) == [Gap(1, 19)]


def test_a_slow_stream_of_another_program_has_its_own_measure() -> None:
    assert GapFinder(1.0, foreign=True).find(np.array([1.0, 2.4])) == []
    assert GapFinder(1.0, foreign=True).find(np.array([1.0, 3.0])) == [Gap(1, 1)]


@settings(deadline=None)
@given(stamps=mixed)
def test_an_irregular_stream_has_no_gaps_but_a_newest_stamp(stamps: list[float]) -> None:
    finder = GapFinder(0.0, foreign=False)
    assert finder.find(np.array(stamps)) == []
    assert finder.last_stamp == next((s for s in reversed(stamps) if math.isfinite(s)), 0.0)


@pytest.mark.parametrize("stamp", [math.nan, math.inf, -math.inf])
def test_what_is_no_time_is_never_the_newest_stamp(stamp: float) -> None:
    finder = GapFinder(RATE, foreign=True)
    assert finder.find(np.array([stamp])) == []
    assert finder.last_stamp == 0.0
    finder.find(np.array([5.0, stamp]))
    assert finder.last_stamp == 5.0


def test_a_step_back_is_no_gap() -> None:
    finder = GapFinder(RATE, foreign=False)
    assert finder.find(np.array([9.0, 3.0, 3.01])) == []
    assert finder.last_stamp == 3.01


# Other programs that stamp on arrival: only what is longer than a burst and their jitter is a gap.
ARRIVALS = {"bursts": bursts(delays(200)), "overlaps": overlaps(delays(200))}


@pytest.mark.parametrize("name", ARRIVALS)
def test_samples_that_are_stamped_on_arrival_are_not_missing(name: str) -> None:
    found = GapFinder(NOMINAL_HZ, foreign=True).find(ARRIVALS[name])
    # Until stamps overlap for the first time, a late packet looks like a loss.
    counted = [each for each in found if each.missing]
    assert len(counted) <= (name == "overlaps")
    assert all(each.place <= 2 * BURST for each in counted)
    assert len(found) <= 1


@pytest.mark.parametrize("name", ARRIVALS)
@pytest.mark.parametrize("lost", [1, 3])
def test_bursts_that_are_missing_are_counted(name: str, lost: int) -> None:
    stamps = without(ARRIVALS[name], [100 * BURST], lost * BURST)
    found = [each for each in GapFinder(NOMINAL_HZ, foreign=True).find(stamps) if each.missing]
    (gap,) = (each for each in found if each.place > 2 * BURST)
    # Of a burst, it is known with the next one whether it was only late.
    assert gap.place == (100 + (name == "bursts")) * BURST
    assert gap.missing == pytest.approx(lost * BURST, abs=BURST / 4)


@settings(deadline=None)
@given(name=st.sampled_from(list(ARRIVALS)), cut=cuts)
def test_bursts_are_the_same_in_any_blocks(name: str, cut: list[int]) -> None:
    compare(
        without(ARRIVALS[name], [9 * BURST], BURST)[: 30 * BURST].tolist(), cut, 130.0, foreign=True
    )
