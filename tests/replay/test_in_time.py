"""When samples are due, and how late they are said to be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.replay.player import BIN_S, Lateness, Timeline, Track

SECONDS = st.floats(0, 1000, allow_subnormal=False)
TIMES = arrays(np.float64, st.integers(1, 30), elements=SECONDS)


class _Sent:
    """In place of an outlet; LSL's own is in the tests of the whole."""

    def __init__(self) -> None:
        self.values: list[int] = []
        self.stamps: list[float] = []

    def block(self, samples: Samples, stamps: NDArray[np.float64]) -> _Sent:
        self._block = samples, stamps
        return self

    def push(self, begin: int, end: int) -> None:
        samples, stamps = self._block
        self.values += np.asarray(samples.values)[begin:end, 0].tolist()
        self.stamps += stamps[begin:end].tolist()


@given(st.lists(TIMES, min_size=1, max_size=5), st.sampled_from([0.5, 1.0, 4.0]))
def test_every_sample_goes_out_once_in_the_order_of_the_file_and_never_before_its_time(
    chunks: list[NDArray[np.float64]], speed: float
) -> None:
    outlet, timeline = _Sent(), Timeline(5.0, 0.0, speed)
    numbers = iter(range(1000))
    blocks = [Samples(times, times, np.array([[next(numbers)] for _ in times])) for times in chunks]
    track = Track(outlet, iter(blocks))  # type: ignore[arg-type]
    while np.isfinite(track.due_s):
        due_s = track.due_s
        stamps = track.send(due_s, timeline)
        assert len(stamps) > 0
        # What runs back goes out late, with its own stamp.
        assert (stamps <= timeline.stamps(np.array([due_s]))[0]).all()
        assert track.due_s >= due_s
    times = np.concatenate(chunks)
    assert outlet.values == list(range(len(times)))
    assert outlet.stamps == timeline.stamps(times).tolist()


@given(SECONDS, SECONDS, st.floats(0.01, 100))
def test_a_timeline_leads_there_and_back(start_s: float, begin_s: float, speed: float) -> None:
    timeline = Timeline(start_s, begin_s, speed)
    stamps = timeline.stamps(np.array([begin_s, begin_s + 10.0]))
    assert stamps.tolist() == pytest.approx([start_s, start_s + 10.0 / speed])
    assert timeline.recorded(float(stamps[1])) == pytest.approx(begin_s + 10.0, abs=1e-6)


@given(arrays(np.float64, st.integers(1, 3000), elements=st.floats(0, 0.5)))
def test_lateness_is_told_to_a_tenth_of_a_millisecond(late: NDArray[np.float64]) -> None:
    account = Lateness()
    for at in range(0, len(late), 2):
        account.add(100.0, 100.0 - late[at : at + 2])
    assert account.most_s == pytest.approx(late.max(), abs=1e-9)
    for percent in (50, 99):
        told_s = account.percentile_s(percent)
        exact_s = np.sort(late)[int(np.ceil(len(late) * percent / 100)) - 1]
        assert exact_s - 1e-9 <= told_s <= exact_s + BIN_S + 1e-9


def test_of_nothing_there_is_no_lateness() -> None:
    assert Lateness().percentile_s(99) == 0.0
