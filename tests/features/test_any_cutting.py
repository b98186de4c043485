"""Any cutting into blocks gives the same, nothing raises, and gaps are never bridged."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biosensor_gateway.features import parameters as at
from biosensor_gateway.features.chains import new_runs
from biosensor_gateway.features.runs import Event
from tests.features import signals

SIGNALS = {
    "ECG": (signals.ecg(130, 40)[0], 130.0),
    "PPG": (signals.pulse(64, 40)[0], 64.0),
    "GSR": (signals.skin(128, 40)[0], 128.0),
    "Respiration": (signals.breath(20, 70), 20.0),
    "Accelerometer": (np.random.default_rng(2).standard_normal((2000, 3)), 50.0),
    "RR": (np.diff(signals.beat_times(50)), 0.0),
}
CUTS = st.lists(st.integers(0, 6000), max_size=40)
UNKNOWN = ("beats", "hrv_live", "hr_live_quality", "hr_state", "br_state")
LEAST = {"ECG": 40, "PPG": 40, "GSR": 30, "Respiration": 20, "Accelerometer": 7, "RR": 50}


def _bits(events: list[Event]) -> list[tuple[str, str, tuple[str, ...]]]:
    """All that a stream of each feature has, in its order; between streams there is none."""
    return sorted(
        ((each.feature, each.stamp.hex(), tuple(v.hex() for v in each.values)) for each in events),
        key=lambda each: each[0],
    )


@pytest.mark.parametrize("kind", SIGNALS)
@given(cuts=CUTS)
@settings(max_examples=8, deadline=None)
def test_any_cutting_gives_the_same_to_the_last_bit(kind: str, cuts: list[int]) -> None:
    values, rate = SIGNALS[kind]
    whole = signals.events_of(kind, values, rate or 1.25)
    assert len(whole) > LEAST[kind]
    assert _bits(signals.events_of(kind, values, rate or 1.25, cuts)) == _bits(whole)


@pytest.mark.parametrize("kind", ["ECG", "PPG", "GSR", "Respiration"])
def test_single_samples_give_the_same_too(kind: str) -> None:
    values, rate = SIGNALS[kind]
    cuts = list(range(len(values)))
    assert _bits(signals.events_of(kind, values, rate, cuts)) == _bits(
        signals.events_of(kind, values, rate)
    )


@pytest.mark.parametrize("kind", list(at.RATES_HZ))
@given(data=st.data())
@settings(max_examples=6, deadline=None)
def test_whatever_finite_comes_nothing_raises_and_no_value_is_missing(
    kind: str, data: st.DataObject
) -> None:
    low, high = at.RATES_HZ[kind]
    rate = data.draw(st.floats(low, high), label="rate")
    seed = data.draw(st.integers(0, 1000), label="seed")
    scale = 10.0 ** data.draw(st.integers(-300, 300), label="scale")
    draw = np.random.default_rng(seed)
    columns = 3 if kind == "Accelerometer" else 1
    values = draw.choice([0.0, 1.0, -1.0, 1e6], (round(min(12 * rate, 4000)), columns))
    values = values * scale if seed % 2 else values + draw.standard_normal(values.shape)
    events = new_runs(kind, rate, foreign=False).take(np.arange(len(values)) / rate, values)
    for event in events:
        # The first beat of a run has no interval, and a window that is not full has no value; of
        # motion nothing is known, and of quality nothing before its window is full.
        if event.feature not in UNKNOWN:
            known = event.values[:-1] if event.feature == "sqi" else event.values
            assert all(map(math.isfinite, known)), event


def test_a_gap_or_a_missing_value_ends_a_window_and_is_not_bridged() -> None:
    signal, beats = signals.ecg(130, 60)
    signal = signal.copy()
    signal[30 * 130 : 30 * 130 + 3] = np.nan
    events = signals.events_of("ECG", signal, 130)
    times = signals.stamps_of(events, "beats")
    intervals = signals.values_of(events, "beats")[:, 0]
    assert np.flatnonzero(np.isnan(intervals)).tolist() == [0, int(np.sum(times < 30))]
    # The window of 30 s had begun again, so there is none to the end.
    hrv = signals.stamps_of(events, "hrv_live")
    assert not ((hrv > 30.1) & (hrv < 60)).any()
    assert np.sum(beats < 60) - len(times) <= 4


@given(st.integers(1, 4999), st.floats(0.07, 5))
@settings(max_examples=6, deadline=None)
def test_a_break_in_the_stamps_is_a_gap(place: int, length_s: float) -> None:
    values, rate = SIGNALS["ECG"]
    stamps = np.arange(len(values)) / rate
    stamps[place:] += length_s
    events = new_runs("ECG", rate, foreign=False).take(stamps, values[:, np.newaxis])
    one_by_one = new_runs("ECG", rate, foreign=False)
    again = [
        event
        for at_ in range(0, len(values), 7)
        for event in one_by_one.take(stamps[at_ : at_ + 7], values[at_ : at_ + 7, np.newaxis])
    ]
    assert _bits(events) == _bits(again)
    for event in events:
        if event.feature == "beats" and place < len(values) and not math.isnan(event.values[0]):
            before = event.stamp - event.values[0]
            assert not before < stamps[place] <= event.stamp


@pytest.mark.parametrize("kind", SIGNALS)
@given(cuts=CUTS, step_s=st.sampled_from([200_000.0, 3.0, -3.0, -200_000.0]))
@settings(max_examples=8, deadline=None)
def test_stamps_that_step_back_silence_nothing(kind: str, cuts: list[int], step_s: float) -> None:
    values, rate = SIGNALS[kind]
    columns = values.reshape(len(values), -1)
    stamps = 1000 + np.arange(len(values)) / (rate or 1.25)
    middle = len(values) // 2
    if step_s > 0:
        # One sample alone is stamped wrongly.
        stamps[middle] += step_s
    else:
        stamps[middle:] += step_s
    runs = new_runs(kind, rate, foreign=False)
    bounds = sorted({0, *(each for each in cuts if each < len(values)), len(values)})
    events: list[Event] = []
    for begin, end in itertools.pairwise(bounds):
        events += runs.take(stamps[begin:end], columns[begin:end])
    alone = new_runs(kind, rate, foreign=False)
    expected = alone.take(stamps[:middle], columns[:middle])
    own = new_runs(kind, rate, foreign=False)
    rest = slice(middle + (step_s > 0), None)
    if step_s > 0:
        expected += new_runs(kind, rate, foreign=False).take(
            stamps[middle : middle + 1], columns[middle : middle + 1]
        )
    expected += own.take(stamps[rest], columns[rest])
    assert runs.steps_back == 1
    assert runs.left_out == 0
    if rate:
        assert _bits(events) == _bits(expected)
    assert len(events) > LEAST[kind] / 2


def test_a_late_sample_is_left_out_and_counted() -> None:
    runs = new_runs("Accelerometer", 50.0, foreign=True)
    stamps = np.array([10.0, 10.02, 10.01, 10.04, np.nan, 10.06])
    runs.take(stamps, np.ones((6, 3)))
    runs.take(np.array([9.5]), np.ones((1, 3)))
    assert (runs.left_out, runs.steps_back) == (3, 0)
