"""Stamps under ``use_sim_time``: nothing is of later than the simulated now."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pylsl
import pytest

from biosensor_common.ros_clock import NS_PER_S
from lsl_to_ros.statistics.ros_time import RosTime, Stamping

NOW_S = 100


def at(now_s: int) -> Stamping:
    """Return the stamping of a node whose ``/clock`` says so many seconds."""
    now = SimpleNamespace(nanoseconds=now_s * NS_PER_S)
    clock = SimpleNamespace(ros_time_is_active=True, now=lambda: now)
    node: Any = SimpleNamespace(get_clock=lambda: clock)
    return Stamping(RosTime(node), lambda: 0.0)


def of_run(now_s: int, *stamps: float) -> list[float]:
    return (at(now_s).of_run(np.array(stamps)) / NS_PER_S).tolist()


@pytest.mark.parametrize("begin", [0.0, 5000.0, -3.0])
def test_the_newest_of_a_run_is_of_now_and_the_others_were_before(begin: float) -> None:
    stamps = [begin + place / 4 for place in range(4)]
    assert of_run(NOW_S, *stamps) == pytest.approx([99.25, 99.5, 99.75, 100.0])


def test_one_sample_is_of_now() -> None:
    assert of_run(NOW_S, 7.0) == [NOW_S]


def test_without_a_clock_all_are_of_its_zero() -> None:
    assert of_run(0, 7.0, 8.0) == [0.0, 0.0]


def test_none_is_of_before_the_clock_began() -> None:
    assert of_run(1, 0.0, 4.5, 5.0) == [0.0, 0.5, 1.0]


def test_stamps_that_run_back_or_are_no_times_stay_within_the_simulation() -> None:
    assert of_run(NOW_S, -1e300, 1e300, 5.0) == [0.0, NOW_S, NOW_S]


# Senders that stamp with ``time.time()`` instead of LSL's clock.

NODE: Any = SimpleNamespace(get_clock=lambda: SimpleNamespace(ros_time_is_active=False))
WEEKS_S = 3e6


def seconds(stamping: Stamping, stamp: float) -> float:
    (found,) = stamping.to_ns(np.array([stamp])).tolist()
    return found * 1e-9


@pytest.mark.parametrize("correction", [0.0, 12.5, -WEEKS_S, WEEKS_S])
def test_unix_stamps_become_the_ros_times_that_they_are(correction: float) -> None:
    stamping = Stamping(RosTime(NODE), lambda: correction)
    now = time.time()
    assert stamping.are_times(np.array([now, now - 3600])).all()
    for stamp in (now, now - 0.125, now + 60, now - 3600):
        assert seconds(stamping, stamp) == pytest.approx(stamp, abs=1e-6)
    assert stamping.is_unix
    # As old as it is, and not by the clock of LSL.
    assert stamping.local(now) == pytest.approx(pylsl.local_clock(), abs=60.0)


@pytest.mark.parametrize(
    "since",
    [0.0, 5000.0, time.time() - pylsl.local_clock()],
    ids=["now", "another computer", "unix"],
)
def test_stamps_of_any_lsl_clock_are_no_unix_stamps(since: float) -> None:
    # The last one is of a program whose LSL clock counts from 1970.
    stamping = Stamping(RosTime(NODE), lambda: -since)
    stamp = pylsl.local_clock() + since
    assert stamping.are_times(np.array([stamp])).all()
    assert seconds(stamping, stamp) == pytest.approx(time.time(), abs=60.0)
    assert not stamping.is_unix


def test_what_is_no_time_stays_none() -> None:
    stamping = Stamping(RosTime(NODE), lambda: 0.0)
    far = np.array([np.nan, np.inf, -np.inf, time.time() + 1e8, 1e300])
    assert not stamping.are_times(far).any()
