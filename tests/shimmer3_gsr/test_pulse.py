"""Beats in a pulse wave: how exact, and when to say nothing."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from biosensor_gateway.devices.shimmer3_gsr.driver.emitter import HeartRate, PulseRate
from biosensor_gateway.simulation.wearer import Wearer

Floats = NDArray[np.float64]
RATES_HZ = (51.2, 128.0, 256.0, 512.0)


def clock(seconds: float, rate_hz: float) -> Floats:
    return 7000 + np.arange(int(seconds * rate_hz)) / rate_hz


def wave(times: Floats, bpm: float, noise_mv: float = 0.5) -> Floats:
    """Return a pulse of 40 mV on an offset that drifts."""
    phase = times * bpm / 60 % 1.0
    systole = np.exp(-0.5 * ((phase - 0.18) / 0.08) ** 2)
    dicrotic = 0.35 * np.exp(-0.5 * ((phase - 0.48) / 0.09) ** 2)
    drift = 1500 + 30 * np.sin(2 * np.pi * 0.1 * times)
    noise = np.random.default_rng(1).normal(0, noise_mv, times.size)
    return 40 * (systole + dicrotic) + drift + noise


def detect(detector: PulseRate, times: Floats, values: Floats) -> list[HeartRate]:
    fed = (
        detector.feed(time_s, value)
        for time_s, value in zip(times.tolist(), values.tolist(), strict=True)
    )
    return [rate for rates in fed for rate in rates]


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("bpm", [48, 72, 110, 165])
def test_a_steady_pulse_is_told_within_half_a_beat_a_minute(bpm: float, rate_hz: float) -> None:
    times = clock(60, rate_hz)
    found = detect(PulseRate(rate_hz), times, wave(times, bpm))
    settled = [rate for rate in found if rate.time_s > times[0] + 10]
    assert max(abs(rate.bpm - bpm) for rate in settled) < 0.5
    # One value a beat, once there have been five.
    assert len(found) == pytest.approx(bpm - 4, abs=4)
    assert all(b.time_s - a.time_s == pytest.approx(60 / bpm, abs=0.02) for a, b in pairwise(found))


def test_a_rate_that_breathes_is_followed() -> None:
    wearer = Wearer(seed=3)
    times = clock(120, 128)
    found = detect(PulseRate(128), times, 1500 + 60 * wearer.pulse(times))
    beats = wearer.beats_between(times[0], times[-1])
    errors = [
        rate.bpm - 60 / np.median(wearer.rr_before(beats[beats < rate.time_s - 0.2][-5:]))
        for rate in found[5:]
    ]
    assert np.max(np.abs(errors)) < 1.0


def test_nothing_before_five_beats() -> None:
    times = clock(30, 128)
    values = np.where(times < times[0] + 10, 1500.0, wave(times, 60, 0))
    found = detect(PulseRate(128), times, values)
    assert found[0].time_s - times[0] > 10 + 4


@pytest.mark.parametrize("quiet_mv", [0.0, 0.3])
def test_without_a_pulse_nothing_is_told(quiet_mv: float) -> None:
    times = clock(120, 128)
    noise = np.random.default_rng(5).normal(1500, quiet_mv, times.size)
    detector = PulseRate(128)
    assert detect(detector, times, noise) == []
    assert not detector.found(float(times[-1]))


def test_a_pulse_that_ends_is_missed_after_two_seconds_and_must_show_again() -> None:
    times = clock(60, 128)
    begin = times[0]
    silent = (times >= begin + 20) & (times < begin + 40)
    values = np.where(silent, 1500.0, wave(times, 72, 0))
    detector = PulseRate(128)
    before = times < begin + 20
    last = detect(detector, times[before], values[before])[-1].time_s
    assert detector.found(last + 1.9)
    assert not detector.found(last + 2.1)
    found = [rate.time_s - begin for rate in detect(detector, times[~before], values[~before])]
    assert [time_s for time_s in found if 21 < time_s < 43] == []
    assert found[-1] > 59
    assert detector.found(float(times[-1]))


def test_a_hole_in_the_signal_makes_no_beat_and_no_false_rate() -> None:
    times = clock(60, 128)
    values = wave(times, 90, 0)
    kept = (times < times[0] + 20) | (times > times[0] + 20.4)
    found = detect(PulseRate(128), times[kept], values[kept])
    assert max(abs(rate.bpm - 90) for rate in found if rate.time_s > times[0] + 5) < 1.0
    gap = [rate for rate in found if 20.4 < rate.time_s - times[0] < 20.4 + 4 * 60 / 90]
    assert gap == []


def test_a_few_lost_samples_cost_nothing() -> None:
    times = clock(60, 128)
    values = wave(times, 90, 0)
    kept = np.arange(times.size) % 40 > 2
    found = detect(PulseRate(128), times[kept], values[kept])
    assert max(abs(rate.bpm - 90) for rate in found if rate.time_s > times[0] + 5) < 3.0
    assert len(found) > 75


def test_one_false_beat_does_not_change_the_rate_and_a_new_rate_is_believed_soon() -> None:
    times = clock(60, 128)
    artefact = 120 * np.exp(-0.5 * ((times - times[0] - 20.13) / 0.05) ** 2)
    slow, fast = wave(times, 60, 0), wave(times, 120, 0)
    values = np.where(times < times[0] + 40, slow + artefact, fast)
    found = detect(PulseRate(128), times, values)
    steady = [rate.bpm for rate in found if 10 < rate.time_s - times[0] < 40]
    assert steady == pytest.approx([60.0] * len(steady), abs=3)
    after = [rate.bpm for rate in found if rate.time_s - times[0] > 47]
    assert after == pytest.approx([120.0] * len(after), abs=1)
    assert len(after) > 20


def test_it_is_causal() -> None:
    times = clock(30, 128)
    values = wave(times, 72)
    half = times.size // 2
    whole = detect(PulseRate(128), times, values)
    other = np.concatenate([values[:half], 1500 + 300 * np.sin(times[half:] * 50)])
    changed = detect(PulseRate(128), times, other)
    known = [rate for rate in whole if rate.time_s < times[half - 2]]
    assert changed[: len(known)] == known


@pytest.mark.parametrize("bpm", [40, 60, 100])
def test_a_pulse_that_is_upside_down_is_found_where_it_is(bpm: float) -> None:
    times = clock(60, 128)
    upright, reflected = (
        detect(PulseRate(128), times, sign * wave(times, bpm, 0)) for sign in (1, -1)
    )
    later = [rate for rate in reflected if rate.time_s > times[0] + 15]
    assert len(later) > 0.7 * bpm
    known = np.array([rate.time_s for rate in upright])
    assert max(np.abs(known - rate.time_s).min() for rate in later) < 0.02
