"""When samples were measured, and how many are missing, by the stamps of their frames."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.polar_h10.driver.emitter import FrameTimeline, Placed

_FOLDER = Path(__file__).parent / "vectors"
(VECTOR,) = [
    vector["expected"]
    for vector in json.loads((_FOLDER / "polar_pmd_h10.json").read_text(encoding="utf-8"))
    if vector["kind"] == "timestamps"
]
START_NS = 599_616_000_000_000_000
COUNT = 73


class Device:
    """Measures at a true rate, and stamps every frame at its last sample."""

    def __init__(self, rate_hz: float = 130.0) -> None:
        self.period_ns = 1e9 / rate_hz
        self.measured = 0
        self.timeline = FrameTimeline(130.0)

    def skip(self, count: int) -> None:
        self.measured += count

    def true_times(self, count: int) -> list[int]:
        return [
            START_NS + round((self.measured + index + 1) * self.period_ns) for index in range(count)
        ]

    def frame(self, count: int = COUNT) -> Placed:
        """Measure a frame and place it, as soon as it is complete."""
        times = self.true_times(count)
        self.measured += count
        return self.timeline.place(times[-1], count, (times[-1] - START_NS) / 1e9)


def worst(placed: Placed, expected: list[int]) -> int:
    """Largest error in ns; whole numbers, which are too long for a float."""
    return max(abs(a - b) for a, b in zip(placed.times_ns, expected, strict=True))


def test_vector_of_the_first_frame() -> None:
    expected: dict[str, Any] = VECTOR
    timeline = FrameTimeline(expected["nominal_hz"])
    placed = timeline.place(expected["frame_ns"], expected["n"], 0.0)
    # The vector's times were computed in floating point, to 64 ns.
    assert worst(placed, expected["sample_ns"]) <= 128
    assert placed.times_ns[-1] == expected["frame_ns"]
    assert (placed.lost, placed.steps_back) == (0, False)


@pytest.mark.parametrize("rate_hz", [127.4, 130.0, 132.6])
def test_the_true_rate_comes_from_the_stamps(rate_hz: float) -> None:
    device = Device(rate_hz)
    device.frame()
    for _ in range(20):
        expected = device.true_times(COUNT)
        placed = device.frame()
        assert worst(placed, expected) <= 2
        assert placed.lost == 0


@pytest.mark.parametrize("rate_hz", [127.4, 130.0, 132.6])
@pytest.mark.parametrize("frames", [1, 2, 10, 100])
def test_lost_frames_are_counted_in_samples(rate_hz: float, frames: int) -> None:
    device = Device(rate_hz)
    for _ in range(5):
        device.frame()
    device.skip(frames * COUNT)
    expected = device.true_times(COUNT)
    placed = device.frame()
    assert placed.lost == frames * COUNT
    # Not stretched over the gap.
    assert worst(placed, expected) <= 100
    assert device.frame().lost == 0


def test_frames_of_one_sample_lose_single_samples() -> None:
    device = Device()
    assert [device.frame(1).lost for _ in range(10)] == [0] * 10
    device.skip(1)
    assert device.frame(1).lost == 1


def test_a_restart_is_a_gap_of_known_length() -> None:
    device = Device(131.0)
    for _ in range(50):
        device.frame()
    device.timeline.restart(130.0)
    device.skip(1310)
    expected = device.true_times(COUNT)
    placed = device.frame()
    assert placed.lost == 1310
    # The rate is known from before.
    assert worst(placed, expected) <= 1000


def test_another_rate_forgets_the_old_one() -> None:
    timeline = FrameTimeline(50.0)
    timeline.place(START_NS, 36, 0.0)
    timeline.place(START_NS + 720_000_000, 36, 0.72)
    timeline.restart(25.0)
    placed = timeline.place(START_NS + 2_160_000_000, 36, 2.16)
    assert np.diff(placed.times_ns) == pytest.approx([40_000_000] * 35)
    assert placed.lost == 0


def test_a_device_that_was_off_measured_nothing() -> None:
    device = Device()
    device.frame()
    device.timeline.restart(130.0)
    placed = device.timeline.place(START_NS + 10**9, COUNT, 300.0)
    assert placed.lost == 0


def test_a_clock_that_is_set_loses_nothing() -> None:
    device = Device()
    device.frame()
    year_ns = 365 * 86_400 * 10**9
    placed = device.timeline.place(START_NS + year_ns, COUNT, 1.1)
    assert (placed.lost, placed.steps_back) == (0, False)
    assert np.diff(placed.times_ns) == pytest.approx([1e9 / 130] * (COUNT - 1), abs=1)


@pytest.mark.parametrize("back_ns", [0, 10**9])
def test_a_clock_that_does_not_advance_falls_back_to_the_nominal_rate(back_ns: int) -> None:
    timeline = FrameTimeline(130.0)
    timeline.place(START_NS, COUNT, 0.0)
    placed = timeline.place(START_NS - back_ns, COUNT, 0.56)
    assert (placed.lost, placed.steps_back) == (0, True)
    assert placed.times_ns[-1] == START_NS - back_ns
    assert np.diff(placed.times_ns) == pytest.approx([1e9 / 130] * (COUNT - 1), abs=1)


@given(
    st.lists(
        st.tuples(st.integers(0, 2**64 - 1), st.integers(1, 300), st.floats(0, 1e6), st.booleans()),
        max_size=30,
    )
)
def test_any_stamps_give_ascending_times_and_no_negative_loss(
    frames: list[tuple[int, int, float, bool]],
) -> None:
    timeline, arrival = FrameTimeline(130.0), 0.0
    for timestamp, count, pause, restarts in frames:
        arrival += pause
        if restarts:
            timeline.restart(130.0)
        placed = timeline.place(timestamp, count, arrival)
        assert len(placed.times_ns) == count
        assert placed.times_ns[-1] == timestamp
        assert all(a <= b for a, b in pairwise(placed.times_ns))
        assert 0 <= placed.lost < 200 * (pause + 10) + 1e6 * 200
