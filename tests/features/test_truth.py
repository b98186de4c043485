"""What is found in signals whose truth is known, and what their quality is said to be."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from biosensor_gateway.features.chains import new_runs
from biosensor_gateway.features.heart import Heart, is_artefact, variability
from biosensor_gateway.features.quality import JUDGES
from tests.features import signals
from tests.features.signals import Array

# What is found in signals whose truth is known.


def _missed(found: Array, truth: Array, within_s: float) -> int:
    return sum(np.abs(found - each).min(initial=np.inf) > within_s for each in truth)


@pytest.mark.parametrize("rate", [80, 130, 250, 512, 2000])
def test_each_r_peak_is_found_at_its_own_sample(rate: float) -> None:
    signal, beats = signals.ecg(rate, 60)
    found = signals.stamps_of(signals.events_of("ECG", signal, rate), "beats")
    decided = beats[beats < 59]
    assert _missed(found, decided, 1.01 / rate + 0.002) <= 1  # the one at the begin
    assert _missed(decided, found[found < 59], 0.05) == 0


@pytest.mark.parametrize(
    ("kind", "make", "rate"),
    [
        ("ECG", signals.ecg, 80),
        ("ECG", signals.ecg, 512),
        ("PPG", signals.pulse, 25),
        ("PPG", signals.pulse, 512),
    ],
)
def test_a_beat_is_told_within_four_tenths_of_a_second_of_its_apex(
    kind: str, make: Callable[[float, float], tuple[Array, Array]], rate: float
) -> None:
    # At a high rate each second costs more, and has as many beats.
    signal = make(rate, 60 if rate < 100 else 25)[0]
    runs = new_runs(kind, rate, foreign=False)
    delays: list[float] = []
    for place, value in enumerate(signal):
        now = place / rate
        events = runs.take(np.array([now]), np.array([[value]]))
        delays += [now - each.stamp for each in events if each.feature == "beats"]
    # The first ones are told together, once it is known what beats are like.
    assert np.percentile(delays[6:], 95) <= 0.4


@pytest.mark.parametrize("factor", [-1.0, 1e-3, 1e6])
@pytest.mark.parametrize(
    ("kind", "make", "rate"), [("ECG", signals.ecg, 250), ("PPG", signals.pulse, 64)]
)
def test_neither_polarity_nor_unit_matters_for_beats_and_quality(
    kind: str, make: Callable[[float, float], tuple[Array, Array]], rate: float, factor: float
) -> None:
    signal, _ = make(rate, 30)
    plain = signals.events_of(kind, signal, rate)
    other = signals.events_of(kind, signal * factor, rate)
    # An upside-down one is looked at for some beats before it is known which side is up.
    beats = (signals.stamps_of(each, "beats")[4:] for each in (plain, other))
    assert np.abs(np.subtract(*beats)).max() < 0.005
    assert signals.values_of(other, "sqi")[:, 0].min() > 0.9


@pytest.mark.parametrize("rate", [25, 64, 128, 2000])
def test_each_pulse_is_found(rate: float) -> None:
    signal, beats = signals.pulse(rate, 60)
    found = signals.stamps_of(signals.events_of("PPG", signal, rate), "beats")
    assert _missed(found, beats[(beats > 2) & (beats < 58)], 0.05) == 0
    assert _missed(beats, found, 0.1) == 0


@pytest.mark.parametrize("rate", [4, 15, 128, 2000])
def test_each_response_is_found_with_its_height(rate: float) -> None:
    signal, peaks = signals.skin(rate, 120)
    events = signals.events_of("GSR", signal, rate)
    found = signals.stamps_of(events, "scr")
    assert len(found) == len(peaks)
    assert np.abs(found - peaks).max() < 0.5
    amplitude, rise_s, _ = signals.values_of(events, "scr").T
    assert amplitude == pytest.approx(0.5, rel=0.1)
    assert rise_s == pytest.approx(peaks[0] - 12.0, abs=0.6)
    level = signals.values_of(events, "scl")[:, 0]
    assert np.abs(level - 5).max() < 0.6


def test_small_responses_are_told_and_are_not_prominent_even_after_a_touch_of_the_electrodes() -> (
    None
):
    large, peaks = signals.skin(32, 240)
    small = 0.09 * (np.roll(large + 0.002 * np.arange(len(large)) / 32, 12 * 32) - 5)
    signal = large + small
    signal[:640] += 9.0 * np.minimum(1, np.arange(640) / 24)
    signal[640:] += 9.0 * np.exp(-np.arange(len(signal) - 640) / 16)
    events = signals.events_of("GSR", signal, 32)
    prominent = signals.stamps_of(events, "scr_prominent")
    # Of the first two it is not known yet that they are large.
    later = prominent[prominent > 55]
    expected = peaks[peaks > 55]
    assert len(later) == len(expected)
    assert np.abs(later - expected).max() < 0.5
    told = signals.stamps_of(events, "scr")
    assert np.sum(told > 55) >= 2 * len(expected) - 1


@pytest.mark.parametrize("rate", [4, 17.857, 2000])
@pytest.mark.parametrize("per_minute", [8, 15, 30])
def test_breathing_has_rate_and_depth(rate: float, per_minute: float) -> None:
    events = signals.events_of("Respiration", signals.breath(rate, 90, per_minute), rate)
    assert signals.values_of(events, "br_live")[-1, 0] == pytest.approx(per_minute, abs=0.5)
    assert signals.values_of(events, "breath_depth")[2:, 0] == pytest.approx(6.0, rel=0.1)


def test_the_rate_of_breaths_with_a_pause_is_told_without_and_with_it() -> None:
    breath_s, held_s = 4.0, 8.2
    t = np.arange(20 * 60) / 20
    phase = np.where(t < 40, t / breath_s, 10 + np.maximum(0, t - 40 - held_s) / breath_s)
    events = signals.events_of("Respiration", -np.cos(2 * np.pi * phase), 20)
    stamps = signals.stamps_of(events, "br_live")
    assert np.array_equal(stamps, signals.stamps_of(events, "br_live_quality"))
    rate, beside = (signals.values_of(events, each) for each in ("br_live", "br_live_quality"))
    after = (stamps > 50) & (stamps < 60)
    assert rate[after, 0] == pytest.approx(15, abs=0.5)
    assert beside[after, 1].max() < 1
    assert beside[after, 3].max() < 13
    assert beside[~after, 3][:5] == pytest.approx(15, abs=0.5)


@pytest.mark.parametrize("coughs", [False, True])
@pytest.mark.parametrize("per_minute", [8, 15, 25])
def test_the_rate_of_breaths_that_vary_is_right_in_nearly_all_windows(
    per_minute: float, coughs: bool
) -> None:
    signal, tops = signals.breaths(20, 600, per_minute, coughs=coughs)
    events = signals.events_of("Respiration", signal, 20)
    wrong: list[float] = []
    for stamp, rate in zip(
        signals.stamps_of(events, "br_live"),
        signals.values_of(events, "br_live")[:, 0],
        strict=True,
    ):
        inside = tops[(tops > stamp - 30.5) & (tops < stamp + 0.5)]
        wrong.append(abs(rate - 60 / np.diff(inside).mean()))
    assert len(wrong) > 0.9 * len(tops)
    assert np.mean(np.array(wrong) <= 1) >= (0.9 if coughs else 0.98)


def _beside_breath(t: Array) -> dict[str, Array]:
    """Return what is in the movement of a chest besides breath."""
    return {
        "heart": 0.15 * np.sin(2 * np.pi * 1.2 * t),
        "noise": 0.1 * np.random.default_rng(3).standard_normal(len(t)),
    }


@pytest.mark.parametrize("rate", [10.0, 25.0])
@pytest.mark.parametrize("beside", ["heart", "noise"])
@pytest.mark.parametrize("held_s", [12.0, 25.0, 40.0])
def test_while_the_breath_is_held_nothing_else_is_breath(
    held_s: float, beside: str, rate: float
) -> None:
    t = np.arange(round(240 * rate)) / rate
    cycle_s = 32 + held_s
    in_cycle = t % cycle_s
    breath = np.where(in_cycle < 32, (1 - np.cos(2 * np.pi * in_cycle / 4)) / 2, 0.0)
    events = signals.events_of("Respiration", breath + _beside_breath(t)[beside], rate)
    stamps = signals.stamps_of(events, "breaths")
    assert len(stamps) > 20
    # Breaths, and those only: there are none in the pause.
    assert (stamps[stamps > 40] % cycle_s).max() < 32.5
    assert signals.values_of(events, "br_live")[6:, 0] == pytest.approx(15, abs=1.5)


@pytest.mark.parametrize("rate", [10.0, 25.0])
@pytest.mark.parametrize("beside", ["heart", "noise"])
@pytest.mark.parametrize("per_minute", [3.5, 5.0, 7.0])
def test_between_slow_breaths_nothing_else_is_breath(
    per_minute: float, beside: str, rate: float
) -> None:
    t = np.arange(round(180 * rate)) / rate
    breath = signals.breath(rate, 180, per_minute) / 6
    events = signals.events_of("Respiration", breath + _beside_breath(t)[beside], rate)
    told = signals.values_of(events, "br_live")[:, 0]
    assert len(told) > 4
    assert told == pytest.approx(per_minute, abs=0.7)


def test_breathing_is_found_again_soon_after_a_jump_of_a_hundred_times_its_depth() -> None:
    signal = signals.breath(20, 120)
    signal[800:] += 600.0
    stamps = signals.stamps_of(signals.events_of("Respiration", signal, 20), "breaths")
    assert np.sum((stamps > 52) & (stamps < 112)) == 15


def test_activity_is_the_mean_deviation_of_the_length() -> None:
    still = np.tile([0.0, 0.6, 0.8], (500, 1))
    moved = still * (1 + 0.3 * np.sign(np.sin(np.arange(500) * 2 * np.pi / 10 + 0.1)))[:, None]
    assert signals.values_of(signals.events_of("Accelerometer", still, 50), "activity_live")[
        :, 0
    ] == pytest.approx([0, 0], abs=1e-12)
    assert signals.values_of(signals.events_of("Accelerometer", moved, 50), "activity_live")[
        :, 0
    ] == pytest.approx([0.3, 0.3])


def test_variability_is_as_defined_and_no_difference_is_taken_across_an_artefact() -> None:
    intervals = np.array([0.80, 0.85, 0.90, 1.80, 0.80, 0.86])
    valid = np.array([True, True, True, False, True, True])
    rmssd, sdnn, pnn50 = variability(intervals, valid)
    assert rmssd == pytest.approx(np.sqrt((50**2 + 50**2 + 60**2) / 3))
    assert sdnn == pytest.approx(np.std([800, 850, 900, 800, 860], ddof=1))
    # The Task Force divides by the count of intervals, not of their differences.
    assert pnn50 == pytest.approx(100 / 5)


def test_a_published_report_comes_out_to_its_printed_digits() -> None:
    # But for pNN50, of which it divides by the count of differences: 28.571.
    intervals = np.loadtxt(Path(__file__).parent / "vectors" / "pyhrv_nni_ms.txt") / 1000
    found = variability(intervals, np.ones(len(intervals), dtype=np.bool_))
    assert [f"{each:.3f}" for each in found] == ["60.523", "85.357", "28.565"]


def test_a_missed_beat_is_an_artefact_and_leaves_rate_and_variability_alone() -> None:
    heart = Heart()
    times = [t for t in np.arange(0.0, 60.0, 0.8) if abs(t - 40.0) > 0.1]
    events = [event for each in times for event in heart.beat(each)]
    flags = signals.values_of(events, "beats")[:, 1]
    assert flags.sum() == 2  # Malik: also the first normal one after it
    assert signals.values_of(events, "hr_live") == pytest.approx(75.0)
    last = signals.values_of(events, "hrv_live")[-1]
    assert last[0] == pytest.approx(0, abs=1e-6)
    assert 0.9 < last[3] < 1
    assert is_artefact(0.29, 0.29)
    assert not is_artefact(0.9, float("nan"))


# What the quality of a window says of signals to which something was added.
Noise = Callable[[Array, float], Array]


@pytest.mark.parametrize("rate", [130.0, 512.0])
def test_quality_tells_a_clean_ecg_from_a_corrupted_one(rate: float) -> None:
    signal, _ = signals.ecg(rate, 60)
    draw = np.random.default_rng(5)
    length = round(10 * rate)
    judge = JUDGES["ECG"]
    noise = 0.5 * draw.standard_normal(len(signal))
    hum = 2 * np.sin(2 * np.pi * 50 * np.arange(len(signal)) / rate)
    for begin in range(0, len(signal) - length + 1, length):
        window = slice(begin, begin + length)
        assert judge(signal[window], rate)[0] > 0.9
        for bad, reason in ((noise, "noisy"), (hum, "noisy")):
            quality, reasons = judge((signal + bad)[window], rate)
            assert quality < 0.5
            assert reason in reasons
    assert judge(np.clip(signal[:length], -0.02, 0.02), rate)[1][0] == "clipped"
    assert judge(np.full(length, 3.0), rate)[1][0] == "flat"


def _band(like: Array, rate: float, low_hz: float, high_hz: float) -> Array:
    """Noise of that band with the power of the signal."""
    spectrum = np.fft.rfft(np.random.default_rng(3).standard_normal(len(like)))
    frequencies = np.fft.rfftfreq(len(like), 1 / rate)
    spectrum[(frequencies < low_hz) | (frequencies > high_hz)] = 0
    noise = np.fft.irfft(spectrum, len(like))
    return noise * like.std() / noise.std()


def _pops(like: Array, rate: float) -> Array:
    """Something that jumps every 8 s and comes back within a second."""
    since_s = np.arange(len(like)) / rate % 8.0
    return 10 * like.std() * np.exp(-since_s / 0.3)


ADDED: dict[str, Noise] = {
    "motion, 0 dB": lambda x, rate: x + _band(x, rate, 0.5, 15),
    "motion, -6 dB": lambda x, rate: x + 2 * _band(x, rate, 0.5, 15),
    "wander": lambda x, rate: x + 5 * _band(x, rate, 0.1, 0.5),
    "pops": lambda x, rate: x + _pops(x, rate),
    "clipped": lambda x, _: np.clip(x, *np.percentile(x, [4, 96])),
}


def _qualities(kind: str, signal: Array, rate: float) -> Array:
    return signals.values_of(signals.events_of(kind, signal, rate), "sqi")[:, 0]


@cache
def _clean(
    kind: str, make: Callable[[float, float], tuple[Array, Array]], rate: float
) -> tuple[Array, Array]:
    """Return a signal to which nothing was added but a little noise, and its quality."""
    signal = make(rate, 120)[0]
    signal = signal + 0.01 * np.random.default_rng(4).standard_normal(len(signal))
    return signal, _qualities(kind, signal, rate)


@pytest.mark.parametrize("added", ADDED)
@pytest.mark.parametrize(
    ("kind", "make", "rate"),
    [
        ("ECG", signals.ecg, 130.0),
        ("ECG", signals.ecg, 512.0),
        ("PPG", signals.pulse, 64.0),
        ("PPG", signals.pulse, 512.0),
    ],
)
def test_quality_is_worse_in_nearly_all_windows_where_something_was_added(
    kind: str, make: Callable[[float, float], tuple[Array, Array]], rate: float, added: str
) -> None:
    signal, clean = _clean(kind, make, rate)
    bad = _qualities(kind, ADDED[added](signal, rate), rate)
    assert clean.min() > 0.9
    # The area under the curve.
    above, same = clean[:, None] > bad, clean[:, None] == bad
    assert np.mean(above + 0.5 * same) >= 0.9
    assert np.median(bad) < 0.5


def test_skin_that_loses_its_electrode_or_is_shaken_is_told() -> None:
    signal = signals.skin(128, 120)[0]
    lost = signal.copy()
    lost[128 * 50 : 128 * 60] = 0.0
    assert _qualities("GSR", signal, 128).min() == 1.0
    # A window ends each second from the tenth on.
    assert _qualities("GSR", lost, 128)[42:52].max() < 0.5
    shaken = signal + 4 * np.sin(2 * np.pi * 1.3 * np.arange(len(signal)) / 128)
    assert _qualities("GSR", shaken, 128).max() < 0.5
    fine_noise = signal + 0.05 * np.random.default_rng(1).standard_normal(len(signal))
    assert _qualities("GSR", fine_noise, 128).min() >= 0.5


@pytest.mark.parametrize(("rate", "noise"), [(4.0, 0.05), (8.0, 0.05), (128.0, 0.3)])
def test_noise_of_skin_is_no_response_and_is_told_where_it_hides_small_ones(
    rate: float, noise: float
) -> None:
    signal, peaks = signals.skin(rate, 240)
    added = noise * np.random.default_rng(2).standard_normal(len(signal))
    clean, noisy, alone = (
        signals.events_of("GSR", each, rate) for each in (signal, signal + added, 5 + added)
    )
    for feature in ("scr", "scr_prominent"):
        assert len(signals.stamps_of(alone, feature)) <= 8  # of 150 and more
        found = signals.stamps_of(noisy, feature)
        assert max(np.abs(found - each).min() for each in peaks) < 2.0
        assert len(found) <= len(peaks) + 3
    told = signals.values_of(noisy, "sqi")
    assert np.mean(told[:, 0] < 0.5) > 0.95
    assert np.mean(told[:, 3]) > 0.95
    assert signals.values_of(clean, "sqi")[:, 0].min() == 1
    # The level is right all the same.
    assert np.median(signals.values_of(noisy, "scl")[:, 0]) == pytest.approx(5, abs=0.5)


@pytest.mark.parametrize("rate", [4.0, 8.0, 15.0])
def test_skin_that_answers_all_the_time_is_not_called_noisy(rate: float) -> None:
    t = np.arange(120 * rate) / rate
    signal = 8 + np.sin(2 * np.pi * t / 3.1) + 0.5 * np.sin(2 * np.pi * t / 1.7)
    assert _qualities("GSR", signal, rate).min() == 1


@pytest.mark.parametrize("rate", [4.0, 15.0, 128.0])
@pytest.mark.parametrize("level", [0.5, 1.5, 5.0, 20.0])
def test_a_jump_of_skin_spoils_what_is_within_five_seconds(level: float, rate: float) -> None:
    # Kleckner 2018, rule 4; and at a wrist, where 10 uS/s cannot be, less is a jump.
    signal = level + (signals.skin(rate, 60)[0] - 5) * min(1.0, level / 5)
    assert _qualities("GSR", signal, rate).min() == 1.0
    jumps = signal.copy()
    jumps[round(30.5 * rate) :] += level / 2
    told = _qualities("GSR", jumps, rate)
    ends_s = 10 + np.arange(len(told))
    assert told[(ends_s > 31) & (ends_s < 36)].max() == 0
    assert told[(ends_s < 30) | (ends_s > 42)].min() == 1


@pytest.mark.parametrize("rate", [4.0, 15.0, 128.0])
@pytest.mark.parametrize("height", [0.3, 1.0, 3.0, -0.3, -1.0, -3.0])
def test_a_touch_or_dip_of_a_second_is_no_response_of_good_quality(
    height: float, rate: float
) -> None:
    # Boucsein 2012: half of a response is gone after 2 s at the earliest.
    signal, peaks = signals.skin(rate, 150)
    assert _qualities("GSR", signal, rate).min() == 1.0
    t = np.arange(len(signal)) / rate
    for moment in (peaks[3] - 5, peaks[5] + 5):
        for shape in (
            np.exp(-0.5 * np.square((t - moment) / 0.35)),
            np.where(np.abs(t - moment) < 0.5, np.cos(np.pi * (t - moment)), 0.0),
        ):
            events = signals.events_of("GSR", signal + height * shape, rate)
            ends, told = signals.stamps_of(events, "sqi"), signals.values_of(events, "sqi")[:, 0]
            found = signals.stamps_of(events, "scr")
            for each in found[np.abs(found - moment) < 2]:
                assert told[(ends >= each) & (ends < each + 4)].min() < 0.5
            assert told[(ends < moment - 1) | (ends > moment + 12)].min() == 1.0


@pytest.mark.parametrize("rate", [4.0, 32.0])
@pytest.mark.parametrize("seed", range(4))
def test_responses_of_any_size_on_a_wandering_level_are_not_called_touches(
    seed: int, rate: float
) -> None:
    draw = np.random.default_rng(seed)
    t = np.arange(round(240 * rate)) / rate
    signal = 6 + 0.5 * np.sin(2 * np.pi * t / 70) + 0.003 * draw.standard_normal(len(t))
    onset_s = 3.0
    while onset_s < 230:
        s = np.maximum(0.0, t - onset_s)
        signal += 0.4 * np.exp(0.6 * draw.standard_normal()) * (np.exp(-s / 4) - np.exp(-s / 0.75))
        onset_s += 4 + draw.exponential(10)
    assert np.mean(_qualities("GSR", signal, rate) < 0.5) < 0.03


@pytest.mark.parametrize(("kind", "first_s"), [("GSR", 10), ("Respiration", 30)])
def test_quality_is_told_each_second_once_its_window_is_full(kind: str, first_s: int) -> None:
    signal = signals.skin(16, 60)[0] if kind == "GSR" else signals.breath(16, 60)
    stamps = signals.stamps_of(signals.events_of(kind, signal, 16), "sqi")
    assert stamps + 1 / 16 == pytest.approx(np.arange(first_s, 61))


def test_breathing_with_a_cough_is_told() -> None:
    signal = signals.breath(20, 150)
    cough = signal.copy()
    cough[1000:1010] += 60.0
    assert _qualities("Respiration", signal, 20).min() > 0.9
    told = _qualities("Respiration", cough, 20)
    # The cough is in the second at 50 s, and windows have 30 s.
    assert told[21:50].max() < 0.5
    assert np.concatenate([told[:20], told[51:]]).min() > 0.9
