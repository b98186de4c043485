"""How far what is told of hearts is off, where every beat is known; and how it is judged."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from biosensor_common.quantities import ChannelFormat
from biosensor_common.stream_header import CoreFields, foreign_header
from biosensor_gateway.features.heart import Heart
from biosensor_gateway.features.runs import Event
from biosensor_gateway.features.sources import judge
from tests.features import signals
from tests.features.signals import Array

SECONDS = 90.0
LEARNT_S = 12.0
ECG_HZ, PULSE_HZ = 250.0, 64.0
Make = Callable[[Array], tuple[str, Array, float]]


class Told(NamedTuple):
    """Heart rates after learning: how far each is off, and whether it is called good."""

    off_bpm: Array
    is_good: NDArray[np.bool_]

    @property
    def wrong(self) -> float:
        """The share of those called good that are off by more than 5 a minute."""
        good = self.off_bpm[self.is_good]
        return float(np.mean(np.abs(good) > 5)) if len(good) else 0.0


def _ecg(beats: Array) -> tuple[str, Array, float]:
    return "ECG", signals.ecg_of(beats, ECG_HZ, SECONDS), ECG_HZ


def _pulse(beats: Array) -> tuple[str, Array, float]:
    return "PPG", signals.pulse_of(beats, PULSE_HZ, SECONDS), PULSE_HZ


def told_of(events: list[Event], beats: Array) -> Told:
    stamps = signals.stamps_of(events, "hr_live")
    rates = signals.values_of(events, "hr_live")[:, 0]
    qualities = signals.values_of(events, "hr_live_quality")[:, 3]
    assert np.array_equal(stamps, signals.stamps_of(events, "hr_live_quality"))
    off: list[float] = []
    for stamp, rate in zip(stamps, rates, strict=True):
        inside = beats[(beats > stamp - 10.3) & (beats <= stamp + 0.3)]
        off.append(rate - 60 / np.mean(np.diff(inside)) if len(inside) > 1 else np.inf)
    learnt = stamps > LEARNT_S
    return Told(np.array(off)[learnt], (qualities >= 0.5)[learnt])


RHYTHMS: dict[str, tuple[Array, float]] = {
    **{f"sinus at {bpm}": (signals.regular(bpm, SECONDS), 0.0) for bpm in (45, 70, 120, 180, 205)},
    **{
        f"fibrillation by {spread} at {bpm}": (signals.fibrillation(bpm, SECONDS, spread), 0.15)
        for spread in (0.18, 0.28)
        for bpm in (70, 100)
    },
    **{
        f"arrhythmia by {swing} at {bpm}": (signals.arrhythmia(bpm, SECONDS, swing), 0.02)
        for swing in (0.2, 0.3)
        for bpm in (50, 75)
    },
    "bigeminy": (signals.bigeminy(SECONDS), 0.0),
}


@pytest.mark.parametrize("rhythm", RHYTHMS)
@pytest.mark.parametrize("make", [_ecg, _pulse], ids=["ECG", "PPG"])
def test_a_rate_that_is_called_good_is_right_in_any_rhythm(make: Make, rhythm: str) -> None:
    beats, most = RHYTHMS[rhythm]
    told = told_of(signals.events_of(*make(beats)), beats)
    assert told.wrong <= most
    # No rhythm is called bad for what it is.
    assert np.mean(told.is_good) > 0.8
    # Nobody is silent: there is a value for nearly every beat.
    assert len(told.off_bpm) > 0.75 * np.sum(beats > LEARNT_S)


@pytest.mark.parametrize("make", [_ecg, _pulse], ids=["ECG", "PPG"])
def test_of_many_hearts_that_fibrillate_at_most_a_twenty_fifth_of_good_rates_is_wrong(
    make: Make,
) -> None:
    # A pulse that comes 0.3 s after another may be missed, which spoils the values of 10 s.
    off: list[Array] = []
    for bpm, spread, seed in ((70, 0.18, 3), (70, 0.28, 3), (100, 0.22, 4), (110, 0.28, 5)):
        beats = signals.fibrillation(bpm, SECONDS, spread, seed)
        told = told_of(signals.events_of(*make(beats)), beats)
        off.append(told.off_bpm[told.is_good])
    assert np.mean(np.abs(np.concatenate(off)) > 5) <= 0.04


@pytest.mark.parametrize("bpm", [30, 34, 38])
def test_of_a_slow_pulse_no_wave_is_counted_twice(bpm: float) -> None:
    beats = signals.regular(bpm, SECONDS, 0.02)
    told = told_of(signals.events_of(*_pulse(beats)), beats)
    assert told.wrong == 0
    assert len(told.off_bpm) == pytest.approx(np.sum(beats > LEARNT_S), abs=3)


@pytest.mark.parametrize(("share", "off_s"), [(0.08, 0.15), (0.1, 0.2)])
@pytest.mark.parametrize("rate", [25.0, 50.0, PULSE_HZ])
@pytest.mark.parametrize("bpm", [30, 32, 38, 42, 46])
def test_between_slow_pulses_neither_noise_nor_a_wandering_level_is_one(
    bpm: float, rate: float, share: float, off_s: float
) -> None:
    beats = signals.regular(bpm, 60, seed=6)
    pulse = signals.pulse_of(beats, rate, 60, seed=4)
    t = 2 * np.pi * np.arange(len(pulse)) / rate
    noise = share * np.random.default_rng(13).standard_normal(len(pulse))
    for beside in (noise, np.sin(0.15 * t), 0.5 * np.sin(0.3 * t)):
        events = signals.events_of("PPG", pulse + beside, rate)
        assert told_of(events, beats).wrong == 0
        found = signals.stamps_of(events, "beats")
        assert max(np.abs(beats - each).min() for each in found[found > LEARNT_S]) < off_s


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.08])
@pytest.mark.parametrize("bpm", [28, 36, 44])
def test_before_the_usual_pulse_is_known_no_small_wave_is_one(bpm: float, noise: float) -> None:
    for seed in range(4):
        beats = signals.regular(bpm, 30, 0.02, seed)
        pulse = signals.pulse_of(beats, 25.0, 30, seed=seed)
        pulse += noise * np.random.default_rng(seed).standard_normal(len(pulse))
        found = signals.stamps_of(signals.events_of("PPG", pulse, 25.0), "beats")
        assert max(np.abs(beats - each).min() for each in found[found < 10]) < 0.3
        assert len(found[found < 10]) >= np.sum(beats < 10) - 1


@pytest.mark.parametrize("pause_s", [1.2, 2.2, 4.0])
@pytest.mark.parametrize("bpm", [42, 65, 95, 140])
@pytest.mark.parametrize("make", [_ecg, _pulse], ids=["ECG", "PPG"])
def test_a_rate_without_its_pauses_is_not_called_good(
    make: Make, bpm: float, pause_s: float
) -> None:
    steady = signals.regular(bpm, SECONDS)
    beats = steady + pause_s * np.floor(steady / 22)
    beats = beats[beats < SECONDS]
    told = told_of(signals.events_of(*make(beats)), beats)
    assert told.wrong == 0
    # Between two of them there is one that is good, where the pulses are not called weak.
    assert told.is_good.any() or bpm < 60


@pytest.mark.parametrize("apex_s", [0.0, 0.15])
@pytest.mark.parametrize("missed", [1, 2, 3])
def test_a_first_interval_that_hides_beats_makes_no_good_rate_wrong(
    missed: int, apex_s: float
) -> None:
    class Clear:
        def worst(self, begin_s: float, end_s: float) -> float:
            return 1.0

    heart = Heart(Clear())
    # Two stamps are off, so that the rhythm seems to be irregular.
    times = np.arange(0.0, 40.0, 0.6) + np.where(np.isin(np.arange(67), (5, 7)), apex_s, 0.0)
    told = [each for t in (times[0], *times[1 + missed :]) for each in heart.beat(t)]
    rates = [each.values[0] for each in told if each.feature == "hr_live"]
    qualities = [each.values[3] for each in told if each.feature == "hr_live_quality"]
    assert all(
        abs(rate - 100) < 5 for rate, each in zip(rates, qualities, strict=True) if each > 0.5
    )
    assert qualities[-1] == 1.0


def test_two_pulses_in_a_row_that_are_missed_are_no_slower_heart() -> None:
    heart = Heart()
    # The second long interval is like the one before it.
    times = [t for t in np.arange(0.0, 40.0, 0.6) if not 20.3 < t < 22.7 or 21.4 < t < 21.7]
    told = [each.values[0] for t in times for each in heart.beat(t) if each.feature == "hr_live"]
    assert told == pytest.approx([100.0] * len(told), abs=0.1)


@pytest.mark.parametrize("share", [0.3, 0.5, 2.0])
@pytest.mark.parametrize(("rate", "hertz"), [(64.0, 60.0), (55.0, 50.0), (55.0, 60.0)])
@pytest.mark.parametrize("bpm", [60, 75, 100])
def test_mains_in_a_slowly_sampled_pulse_are_no_heart(
    bpm: float, rate: float, hertz: float, share: float
) -> None:
    beats = signals.regular(bpm, 40)
    pulse = signals.pulse_of(beats, rate, 40)
    hum = share * np.sin(2 * np.pi * hertz * np.arange(len(pulse)) / rate + 1)
    events = signals.events_of("PPG", pulse + hum, rate)
    # With much of it, nothing is told at all.
    if len(signals.stamps_of(events, "hr_live")):
        assert told_of(events, beats).wrong == 0


@pytest.mark.parametrize("factor", [0.1, 10.0])
@pytest.mark.parametrize("bpm", [38, 75, 120])
@pytest.mark.parametrize("make", [_ecg, _pulse], ids=["ECG", "PPG"])
def test_a_signal_that_is_tenfold_from_one_moment_on_has_the_same_rate(
    make: Make, bpm: float, factor: float
) -> None:
    beats = signals.regular(bpm, SECONDS)
    kind, signal, rate = make(beats)
    signal[len(signal) // 2 :] *= factor
    told = told_of(signals.events_of(kind, signal, rate), beats)
    assert told.wrong == 0
    assert np.mean(told.is_good) > 0.5


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("bpm", [45, 75, 100, 150])
def test_waves_of_an_ecg_that_has_grown_tenfold_are_no_beats(bpm: float, seed: int) -> None:
    beats = signals.regular(bpm, 50, seed=seed)
    signal = signals.ecg_of(beats, 130.0, 50, seed)
    signal[25 * 130 :] *= 10
    events = signals.events_of("ECG", signal, 130.0)
    assert told_of(events, beats).wrong == 0
    found = signals.stamps_of(events, "beats")
    # One T wave may come before the second of the larger beats.
    assert np.sum([np.abs(beats - each).min() > 0.1 for each in found]) <= 3


def test_a_state_is_as_good_as_what_its_rate_was_computed_from() -> None:
    beats = signals.regular(70, SECONDS)
    signal = signals.pulse_of(beats, PULSE_HZ, SECONDS)
    signal += 30 * signals.artefact(SECONDS, PULSE_HZ, 40.0, 0.4)
    events = signals.events_of("PPG", signal, PULSE_HZ)
    stamps = signals.stamps_of(events, "hr_state")
    rate, age_s, quality = signals.values_of(events, "hr_state")[:, :3].T
    beside = signals.values_of(events, "hr_live_quality")[:, 3]
    of_rate = dict(zip(signals.stamps_of(events, "hr_live").round(3), beside, strict=True))
    known = np.isfinite(rate) & (stamps > LEARNT_S)
    for stamp, age, told in zip(stamps[known], age_s[known], quality[known], strict=True):
        assert told <= of_rate[round(stamp - age, 3)]
    # An artefact is looked back at for as long as the rate's own window.
    assert quality[(stamps > 42) & (stamps < 50)].max() < 0.5
    assert quality[stamps > 60].min() > 0.9


@pytest.mark.parametrize("bpm", [45, 60, 80, 100])
def test_a_large_second_wave_is_no_pulse_and_does_not_turn_it_over(bpm: float) -> None:
    beats = signals.regular(bpm, SECONDS, 0.02)
    signal = signals.pulse_of(beats, PULSE_HZ, SECONDS, second=0.9)
    events = signals.events_of("PPG", signal, PULSE_HZ)
    assert told_of(events, beats).wrong == 0
    found = signals.stamps_of(events, "beats")
    assert max(np.abs(beats - each).min() for each in found[found > LEARNT_S]) < 0.1


@pytest.mark.parametrize("sign", [1, -1], ids=["upright", "reflected"])
@pytest.mark.parametrize("width_s", [0.05, 0.15, 0.4])
@pytest.mark.parametrize("height", [10, 30, -10, -30])
def test_an_artefact_moves_no_stamp_fifteen_seconds_later(
    height: float, width_s: float, sign: float
) -> None:
    beats = signals.regular(70, SECONDS)
    bump = signals.artefact(SECONDS, PULSE_HZ, 40.0, width_s)
    signal = sign * signals.pulse_of(beats, PULSE_HZ, SECONDS) + height * bump
    found = signals.stamps_of(signals.events_of("PPG", signal, PULSE_HZ), "beats")
    later = found[found > 55]
    assert len(later) >= np.sum((beats > 55) & (beats < SECONDS - 1.5))
    assert max(np.abs(beats - each).min() for each in later) < 0.1


@pytest.mark.parametrize("hertz", [0.8, 1.1, 2.0])
def test_the_light_of_a_lamp_is_no_good_pulse(hertz: float) -> None:
    t = np.arange(SECONDS * PULSE_HZ) / PULSE_HZ
    noise = 0.02 * np.random.default_rng(2).standard_normal(len(t))
    events = signals.events_of("PPG", np.sin(2 * np.pi * hertz * t) + noise, PULSE_HZ)
    assert signals.values_of(events, "sqi")[:, 0].max() < 0.5
    qualities = signals.values_of(events, "hr_live_quality")[:, 3]
    assert np.nanmax(qualities) < 0.5


@pytest.mark.parametrize("overtone", [0.1, 0.2])
@pytest.mark.parametrize("phase", [0, 2, 4])
def test_the_light_of_a_lamp_with_overtones_is_no_good_pulse(phase: float, overtone: float) -> None:
    noise = 0.02 * np.random.default_rng(2).standard_normal(round(30 * PULSE_HZ))
    t = 2 * np.pi * np.arange(len(noise)) / PULSE_HZ
    for hertz in (0.8, 1.3, 2.0):
        light = np.sin(hertz * t) + overtone * np.sin(2 * hertz * t + phase) + noise
        events = signals.events_of("PPG", light, PULSE_HZ)
        assert signals.values_of(events, "sqi")[:, 0].max() < 0.5
        rectified = signals.events_of("PPG", np.abs(np.sin(hertz / 2 * t)) + noise, PULSE_HZ)
        assert signals.values_of(rectified, "sqi")[:, 0].max() < 0.5


def _saw(phase: Array) -> Array:
    return 1 - phase % 1


def _switched(phase: Array) -> Array:
    return (phase % 1 < 0.3).astype(np.float64)


def _glowing(phase: Array) -> Array:
    return np.exp(-3 * (phase % 1))


def _twice(phase: Array) -> Array:
    return np.sin(2 * np.pi * phase) + 1.3 * np.sin(4 * np.pi * phase + 1)


def _rectified(phase: Array) -> Array:
    return np.abs(np.sin(np.pi * phase))


def _half(phase: Array) -> Array:
    return np.maximum(0, np.sin(2 * np.pi * phase))


@pytest.mark.parametrize("share", [0.02, 0.1])
@pytest.mark.parametrize("rate", [25.0, 64.0, 130.0])
@pytest.mark.parametrize("light", [_saw, _switched, _glowing, _twice, _rectified, _half])
def test_light_of_any_shape_that_repeats_like_a_clock_is_no_good_pulse(
    light: Callable[[Array], Array], rate: float, share: float
) -> None:
    t = np.arange(30 * rate) / rate
    noise = share * np.random.default_rng(2).standard_normal(len(t))
    for hertz in (0.62, 0.8, 1.1, 1.37, 2.0):
        events = signals.events_of("PPG", light(hertz * t) + noise, rate)
        assert signals.values_of(events, "sqi")[:, 0].max() < 0.5, hertz


SWINGS = [(70, 1.0, 2.0), (90, 1.7, 2.0), (70, 1.9, 2.0), (70, 1.9, 1.0), (70, 2.6, 2.0)]


@pytest.mark.parametrize("uneven", [0.0, 0.01], ids=["even", "uneven"])
@pytest.mark.parametrize(("bpm", "hertz", "height"), [*SWINGS, (95, 2.6, 1.0), (120, 2.6, 1.0)])
def test_an_arm_that_swings_is_no_good_pulse_even_without_an_accelerometer(
    bpm: float, hertz: float, height: float, uneven: float
) -> None:
    # By the shape alone, or by the pulse below. One that is a multiple of it still passes.
    beats = signals.regular(bpm, 40)
    swing = signals.swing_of(40, PULSE_HZ, hertz, height, uneven)
    events = signals.events_of("PPG", signals.pulse_of(beats, PULSE_HZ, 40) + swing, PULSE_HZ)
    assert told_of(events, beats).wrong == 0
    assert signals.values_of(events, "sqi")[:, 0].max() < 0.5


@pytest.mark.parametrize("rate", [130.0, 250.0])
@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("bpm", [26, 30, 32])
def test_of_a_slow_ecg_nothing_but_its_beats_is_told_from_the_first_on(
    bpm: float, seed: int, rate: float
) -> None:
    beats = signals.regular(bpm, 40, seed=seed)
    events = signals.events_of("ECG", signals.ecg_of(beats, rate, 40, seed), rate)
    found = signals.stamps_of(events, "beats")
    assert max(np.abs(beats - each).min() for each in found) < 0.02
    assert len(found) == pytest.approx(np.sum(beats < 39), abs=1)
    # A second without a beat is no reason to call it bad.
    assert np.median(signals.values_of(events, "sqi")[:, 0]) >= 0.5


def _rmssd_ms(intervals_s: Array) -> float:
    steps = np.diff(intervals_s)
    return float(np.sqrt(np.mean(steps * steps))) * 1e3


@pytest.mark.parametrize("swing", [0.004, 0.0102, 0.03])
@pytest.mark.parametrize(
    ("kind", "rate"), [("ECG", 100), ("ECG", 130), ("ECG", 250), ("PPG", 25), ("PPG", 64)]
)
def test_variability_is_finer_than_the_sampling(kind: str, rate: float, swing: float) -> None:
    beats = signals.regular(70, 120, swing)
    make = signals.ecg_of if kind == "ECG" else signals.pulse_of
    events = signals.events_of(kind, make(beats, rate, 120), rate)
    stamps = signals.stamps_of(events, "beats")
    intervals = signals.values_of(events, "beats")[:, 0]
    inside = (stamps > beats[10] + 0.1) & (stamps < beats[-3] + 0.1)
    expected = _rmssd_ms(np.diff(beats[10:-2]))
    assert _rmssd_ms(intervals[inside]) == pytest.approx(expected, abs=1.0)
    # Stamps stay those of samples.
    assert np.abs(stamps * rate - np.round(stamps * rate)).max() < 1e-3


def test_variability_says_what_it_was_told_from() -> None:
    beats = signals.regular(70, SECONDS)
    signal = signals.ecg_of(beats, ECG_HZ, SECONDS)
    here = slice(round(40 * ECG_HZ), round(52 * ECG_HZ))
    signal[here] += 0.5 * np.random.default_rng(1).standard_normal(here.stop - here.start)
    events = signals.events_of("ECG", signal, ECG_HZ)
    stamps, values = signals.stamps_of(events, "hrv_live"), signals.values_of(events, "hrv_live")
    rmssd, count, covered, quality = values[:, 0], values[:, 12], values[:, 13], values[:, 14]
    bad = (stamps > 55) & (stamps < 65)
    assert bad.any()
    assert quality[bad].max() < 0.5
    clean = (stamps > 30) & (stamps < 40)
    assert quality[clean].min() > 0.9
    assert covered[clean].min() > 0.95
    assert count[clean] == pytest.approx(35, abs=2)
    assert np.isfinite(rmssd[clean]).all()


def test_variability_is_withheld_where_most_of_the_window_is_not_covered() -> None:
    beats = signals.regular(70, SECONDS)
    paused = beats[(beats < 40) | (beats > 60)]
    events = signals.events_of("ECG", signals.ecg_of(paused, ECG_HZ, SECONDS), ECG_HZ)
    stamps, values = signals.stamps_of(events, "hrv_live"), signals.values_of(events, "hrv_live")
    after = (stamps > 61) & (stamps < 70)
    assert after.any()
    assert values[after, 13].max() < 0.7
    assert np.isnan(values[after, 0]).all()


@pytest.mark.parametrize("lost", [1, 12])
def test_a_hole_that_hides_no_beat_ends_no_window(lost: int) -> None:
    beats = signals.regular(70, SECONDS)
    signal = signals.ecg_of(beats, ECG_HZ, SECONDS)
    stamps = 100.0 + np.arange(len(signal)) / ECG_HZ
    kept = np.arange(len(signal)) % 500 >= lost
    whole = signals.events_of("ECG", signal, ECG_HZ)
    runs = signals.new_runs("ECG", ECG_HZ, foreign=False)
    events = runs.take(stamps[kept], signal[kept, np.newaxis])
    for feature in ("beats", "sqi", "hrv_live"):
        count = len(signals.stamps_of(whole, feature))
        # One of the longer ones may lie on a top.
        assert len(signals.stamps_of(events, feature)) == pytest.approx(count, abs=6), feature
    found, expected = (signals.stamps_of(each, "beats") for each in (events, whole))
    # Where the top itself is lost, one of its neighbours is taken.
    assert np.median([np.abs(expected - each).min() for each in found]) < 1e-9


SLOW: dict[str, tuple[Array, float]] = {
    "GSR": (signals.skin(4, 120)[0], 4.0),
    "Respiration": (signals.breath(8, 120), 8.0),
    "Accelerometer": (np.tile([0.0, 0.6, 0.8], (480, 1)), 4.0),
}


@pytest.mark.parametrize("foreign", [False, True])
@pytest.mark.parametrize("kind", SLOW)
def test_a_lost_sample_of_what_is_slow_ends_no_window_and_two_seconds_do(
    kind: str, foreign: bool
) -> None:
    values, rate = SLOW[kind]
    columns = values.reshape(len(values), -1)
    stamps = np.arange(len(values)) / rate
    whole = signals.new_runs(kind, rate, foreign=foreign).take(stamps, columns)
    kept = np.arange(len(values)) % 29 != 28
    events = signals.new_runs(kind, rate, foreign=foreign).take(stamps[kept], columns[kept])
    assert {each.feature for each in events} == {each.feature for each in whole}
    assert len(events) > 0.9 * len(whole)
    kept = (stamps < 60) | (stamps >= 62)
    runs = signals.new_runs(kind, rate, foreign=foreign)
    windows = {"sqi", "activity_live"}
    told = [e for e in runs.take(stamps[kept], columns[kept]) if e.feature in windows]
    # Another window has to fill first.
    assert min(each.stamp for each in told if each.stamp >= 62) > 66


@pytest.mark.parametrize("rate", [2048.0, 5000.0])
def test_a_fast_ecg_is_averaged(rate: float) -> None:
    core = CoreFields("Amp", "ECG", "amp", "host", 1, rate, ChannelFormat.FLOAT32)
    assert judge("Amp", "amp", foreign_header(core, ("x",), ("mV",))) is not None
    beats = signals.regular(70, 40)
    events = signals.events_of("ECG", signals.ecg_of(beats, rate, 40), rate)
    found = signals.stamps_of(events, "beats")
    decided = beats[beats < 39]
    assert max(np.abs(found - each).min() for each in decided[1:]) < 0.003
    assert signals.values_of(events, "sqi")[:, 0].min() > 0.9


@pytest.mark.parametrize("rate", [130, 250, 1000])
@pytest.mark.parametrize("step", [0.01, 0.025, 0.05])
def test_coarse_steps_of_an_ecg_are_not_flat_at_any_rate(step: float, rate: float) -> None:
    beats = signals.regular(70, 30)
    signal = np.round(signals.ecg_of(beats, rate, 30) / step) * step
    assert signals.values_of(signals.events_of("ECG", signal, rate), "sqi")[:, 0].min() >= 0.5


@pytest.mark.parametrize("rate", [64, 250, 1000])
@pytest.mark.parametrize("steps", [20, 50])
def test_coarse_steps_of_a_pulse_are_not_clipped_at_any_rate(steps: int, rate: float) -> None:
    beats = signals.regular(70, 30)
    signal = signals.pulse_of(beats, rate, 30)
    coarse = signals.values_of(signals.events_of("PPG", np.round(signal * steps), rate), "sqi")
    assert coarse[:, 0].min() >= 0.5
    cut = np.floor(np.minimum(signal, 0.9) * steps + 0.5)
    assert signals.values_of(signals.events_of("PPG", cut, rate), "sqi")[:, 2].min() == 1
    held = np.full(len(signal), 7.0, np.float64)
    assert signals.values_of(signals.events_of("PPG", held, rate), "sqi")[:, 1].min() == 1
