"""What the quality of a window says of signals to which something was added."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from biosensor_gateway.features.quality import JUDGES
from tests.features import signals
from tests.features.signals import Array

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
    signal = make(rate, 120)[0]
    signal = signal + 0.01 * np.random.default_rng(4).standard_normal(len(signal))
    clean = _qualities(kind, signal, rate)
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
