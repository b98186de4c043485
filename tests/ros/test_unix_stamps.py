"""Senders that stamp with ``time.time()`` instead of LSL's clock."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pylsl
import pytest

from lsl_to_ros.statistics.ros_time import RosTime, Stamping

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
