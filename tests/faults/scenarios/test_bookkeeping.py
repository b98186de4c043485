"""Books and tables of the scenarios themselves: what is wrong must show."""

from __future__ import annotations

import numpy as np
import pytest

from tests.faults.matching import UnknownSampleError, match
from tests.faults.recorder import Recorded
from tests.faults.scenarios.ledger import CounterLedger, TruthLedger
from tests.rigs.lab_client import Samples

TIMES = np.arange(100.0, 110.0, 0.1)
VALUES = np.random.default_rng(1).normal(size=(len(TIMES), 1))
TRUTH = Samples(TIMES, VALUES)


def came(*indices: int) -> Recorded:
    rows = list(indices)
    return Recorded(TIMES[rows], VALUES[rows], TIMES[rows])


def test_a_ledger_counts_what_is_lost_within_and_between_settlements() -> None:
    ledger = TruthLedger()
    ledger.settle(came(10, 11, 13), TRUTH)
    ledger.settle(came(), TRUTH)
    ledger.settle(came(16, 17), TRUTH)
    assert (ledger.received, ledger.lost) == (5, 1 + 2)


def test_values_that_stay_the_same_are_taken_without_a_gap() -> None:
    steps = Samples(TIMES, np.repeat([[32.1], [32.2], [32.3], [32.4]], 25, axis=0))
    late = 0.45
    ledger = TruthLedger()
    for begin, end in [(10, 30), (30, 33), (33, 60)]:
        rows = slice(begin, end)
        ledger.settle(Recorded(TIMES[rows] + late, steps.values[rows], TIMES[rows]), steps)
    assert (ledger.received, ledger.lost, ledger.settled_s) == (50, 0, TIMES[59])


SLOW = Samples(np.arange(100.0, 130.0, 5.0), np.array([[71.0], [72], [73], [72], [71], [72]]))


def test_of_values_that_repeat_themselves_those_are_taken_behind_which_the_rest_has_room() -> None:
    alike = Samples(np.arange(100.0, 163.0), np.tile(np.arange(21.0), 3)[:, None])
    all_at_once = Recorded(np.full(60, 165.0), alike.values[3:], np.full(60, 165.0))
    assert match(all_at_once, alike, near_s=70.0).tolist() == list(range(3, 63))


def test_what_is_sent_every_few_seconds_may_be_late_by_more_than_one_of_them() -> None:
    ledger = TruthLedger()
    late_s = np.array([4.6, 5.8, 0.8, 0.0])
    ledger.settle(Recorded(SLOW.times[2:] + late_s, SLOW.values[2:], SLOW.times[2:]), SLOW)
    assert (ledger.received, ledger.lost) == (4, 0)


def test_what_is_sent_every_few_seconds_is_refused_if_it_was_never_sent() -> None:
    never = np.array([[73.0], [70]])
    with pytest.raises(UnknownSampleError):
        TruthLedger().settle(Recorded(SLOW.times[3:5], never, SLOW.times[3:5]), SLOW)


def test_what_was_sent_before_the_first_sample_is_not_lost() -> None:
    ledger = TruthLedger()
    ledger.settle(came(50, 51), TRUTH)
    assert ledger.lost == 0


@pytest.mark.parametrize("again", [(11, 12), (12, 14, 13)], ids=["twice", "out of order"])
def test_a_ledger_refuses_what_comes_twice_or_out_of_order(again: tuple[int, ...]) -> None:
    ledger = TruthLedger()
    ledger.settle(came(10, 11), TRUTH)
    with pytest.raises(UnknownSampleError):
        ledger.settle(came(*again), TRUTH)


def test_what_has_not_come_is_overdue() -> None:
    ledger = TruthLedger()
    assert ledger.overdue(TRUTH, TIMES[89]) == 10
    ledger.settle(came(95), TRUTH)
    assert ledger.overdue(TRUTH, TIMES[89]) == 4


def test_samples_wait_for_the_report_that_counts_them() -> None:
    ledger = CounterLedger(pushed=7, last_stamp=TIMES[10], pending=TIMES[9:12])
    ledger.settle(came(12, 13, 14), 7 + 3, TIMES[13])
    assert ledger.difference == 0
    ledger.settle(came(15, 17), 7 + 3 + 4, TIMES[17])
    assert ledger.difference == -1
