"""What each line of the E4 server puts into which stream, and what the radio lost."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from structlog.testing import capture_logs

from biosensor_gateway.devices.empatica_e4 import SPEC
from biosensor_gateway.devices.empatica_e4.driver.emitter import (
    BRIDGED_S,
    WINDOW_S,
    E4Emitter,
    LossEstimate,
)
from biosensor_gateway.devices.empatica_e4.driver.protocol import Sample, Stream
from tests.rigs.emitter_sink import EmitterSink

# What each line of the E4 server puts into which stream, and what it does not.

UNIX_S = 1_680_442_024.0
ARRIVAL_S = 5_000.0
NAN = math.nan


class LinkedEmitter:
    """An emitter that has been told of a new radio link, and its sink."""

    def __init__(self) -> None:
        self.sink = EmitterSink("empatica_e4")
        self.emitter = E4Emitter(self.sink)
        self.emitter.new_epoch()

    def take(self, stream: Stream, after_s: float, *values: float, late_s: float = 0.0) -> None:
        sample = Sample(stream, UNIX_S + after_s, values)
        self.emitter.take([sample], ARRIVAL_S + after_s + late_s)

    def stream_bvp(self, begin_s: float, end_s: float, *, ahead_s: float = 0.0) -> None:
        """Take BVP; the stamps may run behind what the arrival says by a loss."""
        for number in range(round(begin_s * 64), round(end_s * 64)):
            sample = Sample(Stream.BVP, UNIX_S + number / 64 - ahead_s, (float(number),))
            self.emitter.take([sample], ARRIVAL_S + number / 64)


@pytest.fixture
def bench() -> LinkedEmitter:
    return LinkedEmitter()


def test_values_are_those_of_the_declaration(bench: LinkedEmitter) -> None:
    bench.take(Stream.BVP, 0.0, -12.5)
    bench.take(Stream.ACC, 0.03, -64.0, 0.0, 127.0)
    bench.take(Stream.TMP, 0.0, 33.75)
    bench.take(Stream.GSR, 0.0, 0.0832364)
    bench.take(Stream.BAT, 0.0, 0.73)
    bench.take(Stream.HR, 0.0, 72.5)
    bench.take(Stream.IBI, 0.0, 0.828125)
    emitted = bench.sink.emitted
    assert emitted["bvp"] == [[-12.5]]
    assert emitted["acc"] == [[-1.0, 0.0, 127 / 64]]
    assert emitted["st"] == [[33.75]]
    assert emitted["gsr"] == [[0.0832364]]
    assert emitted["bat"] == [[pytest.approx(73.0)]]
    assert emitted["hr"] == [[72.5]]
    assert emitted["ibi"] == [[0.828125]]
    assert set(emitted) == {stream.data_name for stream in SPEC.streams} - {"tag"}


def test_a_press_of_the_button_is_a_marker(bench: LinkedEmitter) -> None:
    bench.take(Stream.BVP, 0.0, 1.0)
    bench.take(Stream.TAG, 0.5)
    assert bench.sink.texts == [("tag", "button", UNIX_S + 0.5)]


def test_only_what_is_not_late_by_design_moves_the_clock(bench: LinkedEmitter) -> None:
    bench.take(Stream.BVP, 1.0, 1.0)
    bench.take(Stream.ACC, 1.01, 1.0, 2.0, 3.0)
    for stream in (Stream.GSR, Stream.TMP, Stream.IBI, Stream.HR, Stream.BAT):
        bench.take(stream, 0.5, 1.0, late_s=5.6)
    bench.take(Stream.TAG, 0.7)
    assert bench.sink.observed == [
        (UNIX_S + 1.0, ARRIVAL_S + 1.0),
        (UNIX_S + 1.01, ARRIVAL_S + 1.01),
    ]


def test_of_samples_that_arrive_together_the_newest_moves_the_clock(bench: LinkedEmitter) -> None:
    samples = [Sample(Stream.BVP, UNIX_S + k / 64, (1.0,)) for k in range(64)]
    bench.emitter.take(samples, ARRIVAL_S + 1)
    assert bench.sink.observed == [(samples[-1].time_s, ARRIVAL_S + 1)]
    assert bench.sink.times["bvp"] == [sample.time_s for sample in samples]


def test_what_cannot_be_mapped_yet_waits_for_what_can(bench: LinkedEmitter) -> None:
    bench.take(Stream.GSR, 0.0, 1.0)
    bench.take(Stream.GSR, 0.25, 2.0)
    bench.take(Stream.TAG, 0.3)
    assert bench.sink.emitted == {}
    bench.take(Stream.BVP, 0.35, 1.0)
    assert bench.sink.emitted["gsr"] == [[1.0], [2.0]]
    assert len(bench.sink.texts) == 1
    bench.emitter.new_epoch()
    bench.take(Stream.GSR, 0.5, 3.0)
    assert len(bench.sink.emitted["gsr"]) == 2
    bench.take(Stream.ACC, 0.6, 1.0, 1.0, 1.0)
    assert bench.sink.emitted["gsr"] == [[1.0], [2.0], [3.0]]


def test_a_line_that_comes_twice_is_one_sample(bench: LinkedEmitter) -> None:
    for after_s in (0.0, 0.0, 1 / 64, 1 / 64, 2 / 64):
        bench.take(Stream.BVP, after_s, 7.0)
    assert bench.sink.times["bvp"] == [UNIX_S + k / 64 for k in range(3)]
    # A stamp that two streams share is no repetition.
    bench.take(Stream.HR, 1.0, 60.0)
    bench.take(Stream.IBI, 1.0, 1.0)
    assert (len(bench.sink.emitted["hr"]), len(bench.sink.emitted["ibi"])) == (1, 1)


def conduct(bench: LinkedEmitter, values: Sequence[float], begin_s: float = 0.0) -> None:
    for number, value in enumerate(values):
        bench.take(Stream.GSR, begin_s + number / 4, value)


def test_no_conductance_keeps_its_place_and_for_two_seconds_means_not_worn(
    bench: LinkedEmitter,
) -> None:
    bench.take(Stream.BVP, 0.0, 1.0)
    conduct(bench, [1.0] + [0.0] * 7 + [2.0])
    assert [row[0] for row in bench.sink.emitted["quality"]] == [1.0]
    conduct(bench, [0.0] * 12, 3.0)
    conduct(bench, [2.0, 2.0], 6.0)
    assert [row[0] for row in bench.sink.emitted["quality"]] == [1.0, 0.0, 1.0]
    assert bench.sink.times["quality"] == [UNIX_S, UNIX_S + 4.75, UNIX_S + 6.0]
    gsr = np.array(bench.sink.emitted["gsr"])[:, 0]
    assert np.isnan(gsr).tolist() == [False] + [True] * 7 + [False] + [True] * 12 + [False] * 2


def test_at_the_start_a_few_open_samples_do_not_tell(bench: LinkedEmitter) -> None:
    bench.take(Stream.BVP, 0.0, 1.0)
    conduct(bench, [0.0] * 7)
    assert "quality" not in bench.sink.emitted
    conduct(bench, [0.0], 2.0)
    assert [row[0] for row in bench.sink.emitted["quality"]] == [0.0]


def test_without_loss_quality_says_so_every_window(bench: LinkedEmitter) -> None:
    bench.stream_bvp(0, 3 * WINDOW_S + 1)
    np.testing.assert_equal(bench.sink.emitted["quality"], [[NAN, 0.0]] * 3)
    assert set(bench.sink.losses.values()) <= {0}
    assert bench.sink.restarts == [0]


def test_radio_loss_is_counted_for_every_stream_and_starts_the_clock_again(
    bench: LinkedEmitter,
) -> None:
    bench.stream_bvp(0, 15)
    with capture_logs() as logs:
        bench.stream_bvp(17, 45, ahead_s=2.0)
    lost = bench.sink.losses
    assert lost["bvp"] == pytest.approx(128, abs=4)
    assert lost["acc"] == pytest.approx(64, abs=2)
    assert lost["gsr"] == lost["st"] == 8
    assert len(bench.sink.restarts) == 2
    losses = [row[1] for row in bench.sink.emitted["quality"]]
    assert [loss for loss in losses if loss] == [pytest.approx(0.2, abs=0.01)]
    (entry,) = [entry for entry in logs if "estimated" in entry["event"]]
    assert entry["seconds"] == pytest.approx(2.0, abs=0.05)
    # Those that came after are where they were measured.
    newest = bench.sink.times["bvp"][-1]
    assert bench.sink.mapped(newest) == pytest.approx(newest - UNIX_S + 2.0 + ARRIVAL_S, abs=0.02)


def test_a_gap_that_was_told_is_counted_without_another_start_of_the_clock(
    bench: LinkedEmitter,
) -> None:
    bench.stream_bvp(0, 25)
    bench.emitter.new_epoch()
    bench.stream_bvp(30, 55)
    assert bench.sink.losses["bvp"] == pytest.approx(5 * 64, abs=4)
    assert len(bench.sink.restarts) == 2
    # What is lost later is another matter.
    bench.stream_bvp(58, 85, ahead_s=3.0)
    assert bench.sink.losses["bvp"] == pytest.approx(8 * 64, abs=6)
    assert len(bench.sink.restarts) == 3


def test_a_wristband_that_was_switched_off_lost_nothing(bench: LinkedEmitter) -> None:
    bench.stream_bvp(0, 25)
    bench.emitter.switched_off()
    bench.emitter.new_epoch()
    bench.stream_bvp(45, 70)
    assert set(bench.sink.losses.values()) <= {0}


# The estimate of what the radio lost: from numbers of samples and their arrival alone.
RATE_HZ = 64.0
HOUR_S = 3600.0


def arrivals(
    seconds: float, *, drift_ppm: float = 0.0, jitter_s: float = 0.0, seed: int = 0
) -> np.ndarray:
    """When samples of a wristband arrive; positive drift is a slow oscillator."""
    count = int(seconds * RATE_HZ)
    measured = np.arange(count) / RATE_HZ * (1 + drift_ppm * 1e-6)
    delays = np.random.default_rng(seed).uniform(0, jitter_s, count)
    return np.maximum.accumulate(measured + delays)


def estimates(times: Iterable[float], estimate: LossEstimate | None = None) -> Iterator[float]:
    estimate = estimate or LossEstimate(RATE_HZ)
    for time in times:
        lost_s = estimate.take(1, float(time))
        if lost_s is not None:
            yield lost_s


@pytest.mark.parametrize("drift_ppm", [-200, 47, 200, 400])
def test_drift_of_the_oscillator_is_no_loss_however_long(drift_ppm: float) -> None:
    told = list(estimates(arrivals(HOUR_S, drift_ppm=drift_ppm, jitter_s=0.05)))
    assert len(told) == pytest.approx(HOUR_S / WINDOW_S, abs=2)
    assert set(told) == {0.0}


@settings(max_examples=30)
@given(
    share=st.floats(0.01, 0.9),
    drift_ppm=st.floats(-200, 200),
    jitter_s=st.floats(0, 0.1),
    seed=st.integers(0, 99),
)
def test_a_share_of_lost_samples_is_found(
    share: float, drift_ppm: float, jitter_s: float, seed: int
) -> None:
    times = arrivals(120, drift_ppm=drift_ppm, jitter_s=jitter_s, seed=seed)
    kept = times[np.random.default_rng(seed).random(len(times)) >= share]
    told = sum(estimates(kept))
    # Of steady loss, the two newest windows are not told yet; drift may hide a little.
    told_until_s = 120 - 2 * WINDOW_S
    assert told_until_s * share * 0.85 - 0.5 < told < 120 * share * 1.1 + 0.3


@settings(max_examples=30)
@given(st.floats(0.2, 8.0), st.floats(11.0, 30.0))
def test_a_hole_is_told_once_and_whole(hole_s: float, begin_s: float) -> None:
    times = arrivals(80, jitter_s=0.03)
    kept = times[(times < begin_s) | (times >= begin_s + hole_s)]
    told = [lost_s for lost_s in estimates(kept) if lost_s]
    assert len(told) == 1
    assert told[0] == pytest.approx(hole_s, abs=0.06)


def test_a_known_gap_is_told_at_the_end_of_its_own_window() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(60)
    before = list(estimates(times[times < 25], estimate))
    estimate.begin_window()
    after = list(estimates(times[times >= 30], estimate))
    assert set(before) == {0.0}
    assert after[0] == pytest.approx(5.0, abs=0.05)
    assert set(after[1:]) == {0.0}


def test_a_first_sample_that_came_late_hides_no_gap() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(30)
    times[0] = times[20]
    assert list(estimates(times[times < 5], estimate)) == []
    estimate.begin_window()
    told = list(estimates(np.sort(times[times >= 6]), estimate))
    assert told[0] == pytest.approx(1.0, abs=0.05)


def test_a_backlog_is_no_loss() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(60)
    # A server that is held up for 4 s sends everything after it.
    late = np.where((times > 22) & (times < 26), 26.0, times)
    assert set(estimates(late, estimate)) == {0.0}


def test_what_came_before_a_long_silence_says_nothing() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(200 + BRIDGED_S)
    kept = times[(times < 30) | (times > 31 + BRIDGED_S)]
    assert set(estimates(kept, estimate)) == {0.0}


def test_being_switched_off_is_no_loss() -> None:
    estimate = LossEstimate(RATE_HZ)
    times = arrivals(100)
    assert set(estimates(times[times < 30], estimate)) == {0.0}
    estimate.forget()
    assert set(estimates(times[times > 50], estimate)) == {0.0}


@given(st.lists(st.integers(1, 40), min_size=5, max_size=30))
def test_it_does_not_matter_how_samples_are_read_together(sizes: list[int]) -> None:
    times = arrivals(45)
    one, many = LossEstimate(RATE_HZ), LossEstimate(RATE_HZ)
    ends = np.cumsum(sizes)
    ends = [*ends[ends < len(times)].tolist(), len(times)]
    for begin, end in zip([0, *ends], ends, strict=False):
        arrival = float(times[end - 1])
        for _ in range(begin, end - 1):
            assert one.take(1, arrival) in (None, 0.0)
        assert one.take(1, arrival) in (None, 0.0)
        assert many.take(end - begin, arrival) in (None, 0.0)
