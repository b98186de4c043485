"""Stamps under ``use_sim_time``: nothing is of later than the simulated now."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
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
