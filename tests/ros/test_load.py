"""Overload is told once it lasts, and is over once it is clearly less."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from lsl_to_ros.reports.diagnostics import overload
from lsl_to_ros.statistics import stream_status
from lsl_to_ros.statistics.load import REPORTS, SHARE_WINDOW_S, Backlog, Load, LoadFacts
from lsl_to_ros.statistics.stream_status import PublishingRate

WINDOW = round(SHARE_WINDOW_S)


class Process:
    """A node whose time and work are the test's."""

    def __init__(self) -> None:
        self.now_s, self.used_s = 100.0, 7.0
        self.load = Load(lambda: self.now_s, lambda: self.used_s)
        self.load.look()

    def live(self, *shares: float, ages: Sequence[float] = (0.0,)) -> LoadFacts:
        """Live a second at each share of a core, in which data waited so long."""
        return [self._second(share, ages) for share in shares][-1]

    def _second(self, share: float, ages: Sequence[float]) -> LoadFacts:
        self.now_s += 1.0
        self.used_s += share
        for age_s in ages:
            self.load.waited(age_s)
        return self.load.look()


def test_a_short_strain_is_no_overload() -> None:
    node = Process()
    facts = node.live(*[1.3] * 6, *[0.1] * 4)
    assert facts.share == pytest.approx(0.82)
    node = Process()
    facts = node.live(*[1.3] * 5, *[0.1] * 5)
    assert facts.share == pytest.approx(0.7)
    assert overload(facts) == ""


def test_nothing_is_said_of_the_first_seconds() -> None:
    facts = Process().live(*[1.9] * (WINDOW - 1))
    assert facts.share is None
    assert overload(facts) == ""


def test_a_lasting_strain_says_how_much_and_what_to_do() -> None:
    facts = Process().live(*[0.92] * WINDOW, ages=[0.02, 0.31, 0.1])
    said = overload(facts)
    assert "92 % of a core" in said
    assert "0.3 s" in said
    for remedy in ("_chunk", "_stamped", "Sensor_Enable", "stream_predicate"):
        assert remedy in said


def test_what_sways_about_a_limit_is_told_once() -> None:
    node = Process()
    node.live(*[0.9] * WINDOW)
    judged = [node.live(*[share] * WINDOW).is_busy for share in (0.7, 0.82, 0.66, 0.78, 0.6, 0.78)]
    assert judged == [True, True, True, True, False, False]


def test_data_that_wait_only_now_and_then_are_no_overload() -> None:
    node = Process()
    for _ in range(4):
        assert not node.live(*[0.2] * (REPORTS - 1), ages=[3.0]).is_late
        assert not node.live(0.2, ages=[0.1]).is_late


def test_data_that_wait_all_the_time_are_told_until_they_clearly_do_not() -> None:
    node = Process()
    facts = node.live(*[0.2] * WINDOW, ages=[1.4])
    assert (facts.is_late, facts.is_busy) == (True, False)
    said = overload(facts)
    assert "1.4 s" in said
    assert "20 % of a core" in said
    assert "other programs" in said
    assert node.live(*[0.2] * 10, ages=[0.6]).is_late
    assert node.live(*[0.2] * (REPORTS - 1), ages=[0.1]).is_late
    assert not node.live(0.2, ages=[0.1]).is_late


def test_the_oldest_of_what_waits_has_waited_since_it_came() -> None:
    backlog = Backlog()
    assert backlog.age(0.0, 10, 0) == 0.0
    assert backlog.age(1.0, 10, 5) == 0.0
    assert backlog.age(2.0, 10, 9) == 1.0
    # Those of the second look are the oldest now, and then those of the third.
    assert backlog.age(3.0, 16, 8) == 1.0
    assert backlog.age(4.0, 20, 9) == 1.0
    assert backlog.age(5.0, 29, 0) == 0.0
    assert backlog.age(6.0, 29, 1) == 0.0


def test_a_look_in_the_midst_of_a_pull_makes_nothing_older() -> None:
    backlog = Backlog()
    backlog.age(0.0, 0, 100)
    # They have left liblsl and are not counted yet.
    assert backlog.age(1.0, 0, 0) == 0.0
    assert backlog.age(2.0, 100, 30) == 0.0


def test_a_topic_is_too_fast_until_it_is_clearly_slower(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, published = 0.0, 0
    monkeypatch.setattr(stream_status, "monotonic", lambda: now_s)
    flow = PublishingRate()
    judged: list[bool] = []
    for rate in (3900, 4100, 3100, 2900, 3900):
        for _ in range(11):
            now_s += 1.0
            published += rate
            assert flow.look(published, 0) == 0
        judged.append(flow.is_fast)
        assert flow.rate == rate
    assert judged == [False, True, True, False, False]
    # The stream has moved to another topic, which has published nothing yet.
    assert flow.look(0, 0) == 0
    assert flow.rate == 0.0


def test_what_was_not_taken_is_told_for_10_s(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 0.0
    monkeypatch.setattr(stream_status, "monotonic", lambda: now_s)
    flow = PublishingRate()
    grown: list[int] = []
    for second in range(15):
        now_s = float(second)
        grown.append(flow.look(100, 50 if second >= 2 else 0))
    assert grown == [0, 0, *[50] * 10, 0, 0, 0]
