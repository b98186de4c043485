"""That half of a heart's beats, which are small, are not left out of a rate that is called good."""

from __future__ import annotations

import numpy as np
import pytest

from tests.features import signals
from tests.features.signals import Array
from tests.features.test_hearts import told_of

SECONDS = 40.0


def _alternating(kind: str, beats: Array, rate: float, share: float) -> Array:
    """Return a signal in which every second beat has this share of the height of the others."""
    if kind == "ECG":
        large = signals.ecg_of(beats[::2], rate, SECONDS)
        return large + share * signals.ecg_of(beats[1::2], rate, SECONDS, 2)
    return signals.pulse_of(beats[::2], rate, SECONDS) + share * signals.pulse_of(
        beats[1::2], rate, SECONDS, seed=2
    )


@pytest.mark.parametrize("share", [0.25, 0.35, 0.5])
@pytest.mark.parametrize("bpm", [60, 75])
@pytest.mark.parametrize(("kind", "rate"), [("ECG", 130.0), ("ECG", 250.0), ("PPG", 64.0)])
def test_a_rate_without_every_second_beat_is_not_called_good(
    kind: str, rate: float, bpm: float, share: float
) -> None:
    beats = signals.regular(bpm, SECONDS)
    told = told_of(signals.events_of(kind, _alternating(kind, beats, rate, share), rate), beats)
    assert len(told.off_bpm)
    assert told.wrong == 0


@pytest.mark.parametrize("share", [0.12, 0.2, 0.3, 0.45])
@pytest.mark.parametrize("coupling", [0.6, 0.75])
def test_early_beats_that_are_small_are_not_left_out_of_a_good_rate(
    coupling: float, share: float
) -> None:
    beats = np.arange(1.0, SECONDS, 2.0)
    early = beats + 2.0 * coupling / 1.6
    signal = signals.ecg_of(beats, 250.0, SECONDS) + share * signals.ecg_of(early, 250.0, SECONDS)
    every = np.sort(np.concatenate([beats, early]))
    assert told_of(signals.events_of("ECG", signal, 250.0), every).wrong == 0


@pytest.mark.parametrize("every", [2, 3])
@pytest.mark.parametrize("share", [0.1, 0.12])
def test_beats_smaller_than_a_p_wave_are_not_left_out_of_a_good_rate(
    share: float, every: int
) -> None:
    beats = signals.regular(68, SECONDS, 0.02)
    is_small = np.arange(len(beats)) % every == every - 1
    signal = signals.ecg_of(beats[~is_small], 130.0, SECONDS)
    signal += share * signals.ecg_of(beats[is_small], 130.0, SECONDS, 2)
    assert told_of(signals.events_of("ECG", signal, 130.0), beats).wrong == 0


def test_noise_behind_a_beat_hides_none() -> None:
    beats = signals.regular(66, SECONDS, 0.02)
    draw = np.random.default_rng(4)
    signal = signals.ecg_of(beats, 125.0, SECONDS)
    # Muscles, whose noise looks like a small QRS complex now and then.
    signal += np.convolve(0.1 * draw.standard_normal(len(signal)), [0.3, 0.4, 0.3], "same")
    events = signals.events_of("ECG", signal, 125.0)
    beside = signals.values_of(events, "beats")
    assert np.mean(beside[5:, 1]) < 0.15


def test_variability_counts_no_interval_that_hides_a_beat() -> None:
    beats = signals.regular(60, SECONDS)
    events = signals.events_of("ECG", _alternating("ECG", beats, 250.0, 0.35), 250.0)
    assert np.isnan(signals.values_of(events, "hrv_live")[:, 0]).all()


@pytest.mark.parametrize("bpm", [30, 45, 60])
def test_neither_waves_of_a_beat_nor_those_of_the_atria_hide_one(bpm: float) -> None:
    beats = signals.regular(bpm, SECONDS)
    t = np.arange(round(SECONDS * 250)) / 250
    atria = sum(0.25 * np.exp(-0.5 * ((t - each) / 0.022) ** 2) for each in np.arange(0, 40, 0.71))
    for kind, rate, signal in (
        ("ECG", 250.0, signals.ecg_of(beats, 250.0, SECONDS)),
        ("ECG", 250.0, signals.ecg_of(beats, 250.0, SECONDS) + atria),
        ("PPG", 64.0, signals.pulse_of(beats, 64.0, SECONDS)),
    ):
        told = told_of(signals.events_of(kind, signal, rate), beats)
        assert np.mean(told.is_good) > 0.8


@pytest.mark.parametrize("rate", [130.0, 250.0])
@pytest.mark.parametrize("bpm", [26, 30, 34, 38])
def test_noise_of_an_ecg_that_has_grown_a_hundredfold_is_no_beat(bpm: float, rate: float) -> None:
    beats = signals.regular(bpm, 60, 0.02)
    signal = signals.ecg_of(beats, rate, 60)
    signal[round(25.3 * rate) :] *= 100
    events = signals.events_of("ECG", signal, rate)
    told = told_of(events, beats)
    # Quality is known each second, so that what is told of the first one may be wrong.
    is_later = signals.stamps_of(events, "hr_live")[-len(told.off_bpm) :] > 26.3
    assert np.abs(told.off_bpm[told.is_good & is_later]).max() <= 5
    found = signals.stamps_of(events, "beats")
    # Noise was, until there were three of the large ones.
    assert max(np.abs(beats - each).min() for each in found[found > 25.3 + 4 * 60 / bpm]) < 0.02
