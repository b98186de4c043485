"""Any cutting into blocks gives the same, nothing raises, and gaps are never bridged."""

from __future__ import annotations

import gc
import itertools
import math
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from biosensor_gateway.features import parameters as at
from biosensor_gateway.features.chains import new_runs
from biosensor_gateway.features.runs import Event
from biosensor_gateway.features.witnesses import Motion, Warmth, Witness
from tests.features import signals
from tests.features.signals import Array

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


# What live features keep: each second's state, and no more as time goes on.

# Each second of a rate: its newest value, its age and its quality.

SECONDS, RATE = 60.0, 250.0


def test_a_heart_rate_is_joined_with_its_age_and_quality_each_second() -> None:
    beats = signals.regular(70, SECONDS)
    events = signals.events_of("ECG", signals.ecg_of(beats, RATE, SECONDS), RATE)
    stamps, told = signals.stamps_of(events, "hr_state"), signals.values_of(events, "hr_state")
    assert stamps + 1 / RATE == pytest.approx(np.arange(1, SECONDS + 1))
    rates, ages, qualities, motions, counts = told.T
    learnt = stamps > 12
    assert rates[learnt] == pytest.approx(70, abs=3)
    assert ages[learnt].min() > 0
    assert ages[learnt].max() < 1.5
    assert qualities[learnt].min() > 0.9
    assert counts[learnt].min() >= 10
    assert np.isnan(motions).all()
    # Nothing is made up before anything is known.
    assert np.isnan(told[:2, :3]).all()
    moments = signals.stamps_of(events, "hr_live")
    # Each is one that was told by then, and beats are decided within half a second.
    newest = [moments[moments <= each].max() for each in stamps[learnt]]
    assert np.all(stamps[learnt] - ages[learnt] >= np.array(newest) - 1.2)


def test_electrodes_that_come_off_leave_no_rate_and_no_good_quality() -> None:
    beats = signals.regular(70, SECONDS)
    signal = signals.ecg_of(beats, RATE, SECONDS)
    off = round(30 * RATE)
    signal[off:] = 0.3 * np.random.default_rng(6).standard_normal(len(signal) - off)
    events = signals.events_of("ECG", signal, RATE)
    stamps, told = signals.stamps_of(events, "hr_state"), signals.values_of(events, "hr_state")
    # A tree that asks for quality is warned within three seconds, not at the end of ten.
    assert told[stamps > 33, 2].max() < 0.5
    flat = signals.ecg_of(beats, RATE, SECONDS)
    flat[off:] = 0.0
    events = signals.events_of("ECG", flat, RATE)
    stamps, told = signals.stamps_of(events, "hr_state"), signals.values_of(events, "hr_state")
    assert np.isnan(told[stamps > 36, 0]).all()
    assert told[stamps > 36, 1].min() > 5


def test_a_rate_of_breathing_says_how_old_it_is_while_a_breath_is_held() -> None:
    signal = signals.breath(20, 120)
    signal[60 * 20 :] = signal[60 * 20]
    events = signals.events_of("Respiration", signal, 20)
    stamps, told = signals.stamps_of(events, "br_state"), signals.values_of(events, "br_state")
    before, late = (stamps > 40) & (stamps < 58), stamps > 90
    assert told[before, 0] == pytest.approx(15, abs=1)
    assert told[before, 2].min() > 0.5
    assert np.isnan(told[late, 0]).all()
    assert told[late, 1].min() > 25


# What detectors keep does not grow with time.
_MINUTES = 7
"""Longer than all that is kept: windows of 5 min, and a minute more of their quality."""
_SIGNALS: dict[str, tuple[Array, float]] = {
    "ECG": (signals.ecg(80, 60 * _MINUTES)[0], 80.0),
    "PPG": (signals.pulse(20, 60 * _MINUTES)[0], 20.0),
    "GSR": (signals.skin(8, 60 * _MINUTES)[0], 8.0),
    "Respiration": (signals.breaths(10, 60 * _MINUTES, 15, coughs=True)[0], 10.0),
    "Accelerometer": (np.tile([0.0, 0.6, 0.8], (600 * _MINUTES, 1)), 10.0),
    "RR": (np.full(75 * _MINUTES, 0.8), 0.0),
}


def _bytes(root: Any) -> int:
    """Bytes of all that hangs on an object, without classes, functions and modules."""
    seen: set[int] = set()
    left, total = [root], 0
    while left:
        each = left.pop()
        if id(each) in seen or isinstance(each, type(gc) | type | type(_bytes)):
            continue
        seen.add(id(each))
        total += sys.getsizeof(each)
        left += gc.get_referents(each)
    return total


@pytest.mark.parametrize("kind", _SIGNALS)
def test_what_is_kept_once_all_windows_are_full_grows_no_more(kind: str) -> None:
    values, rate = _SIGNALS[kind]
    runs = new_runs(kind, rate, foreign=False)
    stamps = np.arange(len(values)) / (rate or 1.25)
    columns = values.reshape(len(values), -1)
    sizes: list[int] = []
    block = max(1, round(rate))
    for repeat in range(3):
        for begin in range(0, len(values), block):
            here = slice(begin, begin + block)
            runs.take(stamps[here] + repeat * 60 * _MINUTES, columns[here])
        sizes.append(_bytes(runs))
    # One number more for each ten seconds would be more than this.
    assert max(sizes[1:]) < sizes[0] + 4096
    assert max(sizes) < 2_000_000


@pytest.mark.parametrize(
    ("witness", "columns"),
    [(Warmth(keep_s=60), 1), (Motion(4.0, foreign=False, keep_s=60), 3)],
    ids=["temperature", "acceleration"],
)
def test_what_other_streams_say_is_forgotten_in_time(witness: Witness, columns: int) -> None:
    sizes: list[int] = []
    for begin_s in range(0, 1200, 60):
        witness.take(begin_s + np.arange(240) / 4, np.full((240, columns), 33.0))
        sizes.append(_bytes(witness))
    # It is kept for 60 s at least, and twice that at most.
    assert max(sizes) <= 1.3 * max(sizes[:3])
