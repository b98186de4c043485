"""What live features keep: each second's state, and no more as time goes on."""

from __future__ import annotations

import gc
import sys
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.features.chains import new_runs
from biosensor_gateway.features.witnesses import Motion, Warmth, Witness
from tests.features import hearts, signals
from tests.features.signals import Array

# Each second of a rate: its newest value, its age and its quality.

SECONDS, RATE = 60.0, 250.0


def test_a_heart_rate_is_joined_with_its_age_and_quality_each_second() -> None:
    beats = hearts.regular(70, SECONDS)
    events = signals.events_of("ECG", hearts.ecg_of(beats, RATE, SECONDS), RATE)
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
    beats = hearts.regular(70, SECONDS)
    signal = hearts.ecg_of(beats, RATE, SECONDS)
    off = round(30 * RATE)
    signal[off:] = 0.3 * np.random.default_rng(6).standard_normal(len(signal) - off)
    events = signals.events_of("ECG", signal, RATE)
    stamps, told = signals.stamps_of(events, "hr_state"), signals.values_of(events, "hr_state")
    # A tree that asks for quality is warned within three seconds, not at the end of ten.
    assert told[stamps > 33, 2].max() < 0.5
    flat = hearts.ecg_of(beats, RATE, SECONDS)
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
    for repeat in range(4):
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
