"""The node's count of lost samples is exact, however samples and reports are interleaved."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from hypothesis import given
from hypothesis import strategies as st

from lsl_to_ros.statistics.losses import CountersComparison, Losses


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
