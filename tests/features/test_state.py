"""Each second of a rate: its newest value, its age and its quality."""

from __future__ import annotations

import numpy as np
import pytest

from tests.features import hearts, signals

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
