"""Which looks at the node are published on ``/diagnostics``."""

from __future__ import annotations

import math

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from lsl_to_ros.parameters.node import DIAGNOSTICS_PERIOD, fault
from lsl_to_ros.reports.reporter import Rhythm

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN


def statuses(*levels: bytes) -> list[DiagnosticStatus]:
    return [DiagnosticStatus(name=f"{at}", level=level) for at, level in enumerate(levels)]


@pytest.mark.parametrize(("period_s", "every"), [(1.0, 1), (1.4, 1), (3.0, 3), (10.0, 10)])
def test_each_so_many_looks_one_is_published(period_s: float, every: int) -> None:
    rhythm = Rhythm(lambda: period_s)
    due = [rhythm.is_due(statuses(OK)) for _ in range(30)]
    # The first entry is news.
    assert [at for at, is_due in enumerate(due) if is_due] == list(range(0, 30, every))


@pytest.mark.parametrize("worse", [(WARN, OK), (OK, OK, OK), (OK,)])
def test_news_do_not_wait(worse: tuple[bytes, ...]) -> None:
    rhythm = Rhythm(lambda: 100.0)
    looks = [(OK, OK), (OK, OK), worse, worse, (OK, OK)]
    due = [rhythm.is_due(statuses(*levels)) for levels in looks]
    assert due == [True, False, True, False, True]


@pytest.mark.parametrize("value", [0.0, 0.9, -1.0, 3601.0, math.nan, math.inf])
def test_other_periods_are_refused(value: float) -> None:
    assert "must be from 1 to 3600 seconds" in (fault(DIAGNOSTICS_PERIOD, value) or "")
    assert fault(DIAGNOSTICS_PERIOD, 1) is None
