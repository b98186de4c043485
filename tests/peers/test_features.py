"""Live features of real recordings are what other people's detectors find in the whole of them.

The recordings and the detectors are in the peers' environment; what is claimed here is in
docs/features.md, and so is what is not.
"""

from __future__ import annotations

import subprocess
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from biosensor_gateway.features.runs import Event
from tests.features.signals import events_of, stamps_of, values_of

pytestmark = pytest.mark.nightly

PEERS = Path(__file__).parent
ENVIRONMENT = PEERS.parents[1] / ".venv-peers"
DEADLINE_S = 200.0
BEGIN_S, END_S = 4.0, 1.0
"""Learning takes the first beats of a recording, and the last is not decided."""

Array = NDArray[np.float64]
Recordings = Mapping[str, Array]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Recordings:
    """Signals, and events that others found in them; of one process, for it loads a lot."""
    # A skip would pass where nothing was tried.
    if not (ENVIRONMENT / ".installed").exists():
        pytest.fail("the peers are not installed: run `make venv-peers` first")
    path = tmp_path_factory.mktemp("features") / "recordings.npz"
    command = [ENVIRONMENT / "bin" / "python", PEERS / "features_reads.py", path]
    done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert done.returncode == 0, done.stderr
    with np.load(path) as kept:
        return dict(kept)


def _live(recordings: Recordings, kind: str, name: str) -> list[Event]:
    """What comes of a recording in pieces, as it would live."""
    rate = float(name.rpartition("_")[2]) if not name.startswith("simulated") else 20.0
    values = recordings[name]
    return events_of(kind, values, rate, list(range(0, len(values), max(1, round(rate / 5)))))


def _pairs(ours: Array, theirs: Array, within_s: float) -> Array:
    """Differences of those that belong together; each is of one pair only."""
    differences: list[float] = []
    place = 0
    for each in ours.tolist():
        while place < len(theirs) and theirs[place] < each - within_s:
            place += 1
        if place < len(theirs) and theirs[place] <= each + within_s:
            differences.append(each - float(theirs[place]))
            place += 1
    return np.array(differences)


def _shares(ours: Array, theirs: Array, within_s: float) -> tuple[float, float]:
    """Return the share of theirs that are ours, and of ours that are theirs."""
    matched = len(_pairs(ours, theirs, within_s))
    return matched / len(theirs), matched / len(ours)


def _f1(ours: Array, theirs: Array, within_s: float) -> float:
    found, right = _shares(ours, theirs, within_s)
    return 2 * found * right / (found + right)


def _inside(times: Array, end_s: float) -> Array:
    return times[(times > BEGIN_S) & (times < end_s - END_S)]


@pytest.mark.parametrize("rate", [128, 130, 250, 512, 1000])
def test_beats_are_those_on_which_two_detectors_agree(recordings: Recordings, rate: int) -> None:
    name = f"ecg_{rate}"
    end_s = len(recordings[name]) / rate
    first, second = recordings["ecg_neurokit"], recordings["ecg_sleepecg"]
    agreed = np.array([each for each in first if np.abs(second - each).min() < 0.05])
    theirs = _inside(agreed, end_s)
    ours = _inside(stamps_of(_live(recordings, "ECG", name), "beats"), end_s)
    found, right = _shares(ours, theirs, 0.05)
    assert found >= 0.995
    assert right >= 0.995
    apart = np.abs(_pairs(ours, theirs, 0.05))
    assert np.median(apart) <= 1 / rate


def test_of_an_arrhythmia_nothing_is_claimed_but_that_two_detectors_differ_more(
    recordings: Recordings,
) -> None:
    ours = stamps_of(_live(recordings, "ECG", "arrhythmia_360"), "beats")
    first, second = recordings["arrhythmia_neurokit"], recordings["arrhythmia_sleepecg"]
    between = _f1(first, second, 0.05)
    assert max(_f1(ours, first, 0.05), _f1(ours, second, 0.05)) > between


@pytest.mark.parametrize("sign", [1, -1], ids=["upright", "reflected"])
def test_pulses_are_those_of_neurokit(recordings: Recordings, sign: int) -> None:
    signal = {"ppg_75": sign * recordings["ppg_75"].astype(np.float64)}
    ours = stamps_of(_live(signal, "PPG", "ppg_75"), "beats")
    found, right = _shares(ours, recordings["ppg_neurokit"], 0.1)
    assert found >= 0.98
    assert right >= 0.98


@pytest.mark.parametrize("rate", [4, 15, 128])
def test_responses_of_the_skin_are_those_of_neurokit(recordings: Recordings, rate: int) -> None:
    events = _live(recordings, "GSR", f"skin_{rate}")
    assert _f1(stamps_of(events, "scr_prominent"), recordings["skin_default"], 1.0) >= 0.9
    # By an absolute limit: theirs and ours of 0.05 uS or more.
    amplitudes = values_of(events, "scr")[:, 0]
    ours = stamps_of(events, "scr")[amplitudes >= 0.05]
    assert _f1(ours, recordings["skin_005"], 1.0) >= 0.9


@pytest.mark.parametrize("per_minute", [8, 12, 18, 30])
def test_breaths_a_minute_are_what_neurokit_simulates(
    recordings: Recordings, per_minute: int
) -> None:
    events = _live(recordings, "Respiration", f"simulated_{per_minute}")
    rates = values_of(events, "br_live")[:, 0]
    assert len(rates) >= 2.5 * per_minute
    # One of its methods varies the rate.
    assert np.mean(np.abs(rates - per_minute) <= 1) >= 0.95


def test_breaths_of_a_poor_recording_are_mostly_those_of_neurokit(recordings: Recordings) -> None:
    events = _live(recordings, "Respiration", "breath_20")
    ours = stamps_of(events, "breaths")
    peers = [recordings[f"breath_{each}"] for each in ("khodadad2018", "biosppy")]
    assert _f1(ours, peers[0], 0.5) >= 0.89
    stamps, rates = stamps_of(events, "br_live"), values_of(events, "br_live")[:, 0]
    told = np.array([[_rate(each, stamp) for each in peers] for stamp in stamps])
    agree = np.abs(told[:, 0] - told[:, 1]) <= 1
    # They agree on three windows of five only, so more than in these cannot be right.
    assert 0.5 < agree.mean() < 0.7
    assert np.mean(np.abs(rates - told.mean(axis=1))[agree] <= 1) >= 0.74


def _rate(tops: Array, stamp: float) -> float:
    """By their breaths, what is told by ours."""
    intervals = np.diff(tops)[(tops[1:] > stamp - 30.3) & (tops[1:] <= stamp + 0.3)]
    if len(intervals) < 2:
        return np.nan
    middle = np.median(intervals)
    alike = intervals[(intervals >= middle / 1.6) & (intervals <= middle * 1.6)]
    return float(60 / (alike if len(alike) else intervals).mean())


def _noise(like: Array, rate: float, low_hz: float, high_hz: float) -> Array:
    spectrum = np.fft.rfft(np.random.default_rng(1).standard_normal(len(like)))
    frequencies = np.fft.rfftfreq(len(like), 1 / rate)
    spectrum[(frequencies < low_hz) | (frequencies > high_hz)] = 0
    noise = np.fft.irfft(spectrum, len(like))
    return noise * like.std() / noise.std()


def _corrupted(signal: Array, rate: float, motion_hz: float) -> dict[str, Array]:
    """What is added is of the signal's own spread, or so many times as much."""
    windows = signal.reshape(-1, round(10 * rate))
    seconds, spread = np.arange(len(signal)) / rate, signal.std()
    motion = _noise(signal, rate, 0.5, motion_hz)
    bad = {
        "wander": signal + 5 * spread * np.sin(2 * np.pi * 0.3 * seconds),
        "motion, 0 dB": signal + motion,
        "motion, -6 dB": signal + 2 * motion,
        # One in each window, at another place.
        "pops": signal + 10 * spread * np.exp(-(seconds % 9.5) / 0.3),
        # In each window again, for the pulse is not equally strong in all.
        "clipped": np.clip(
            windows, *np.percentile(windows, [2, 98], axis=1, keepdims=True)
        ).ravel(),
    }
    if rate > 110:
        bad["hum"] = signal + 1.41 * spread * np.sin(2 * np.pi * 50 * seconds)
    return bad


def _qualities(kind: str, signal: Array, rate: float) -> Array:
    """Of windows that follow each other; there is one every second."""
    return values_of(events_of(kind, signal, rate), "sqi")[::10, 0]


@pytest.mark.parametrize(
    ("kind", "name"), [("ECG", "ecg_130"), ("ECG", "ecg_250"), ("PPG", "ppg_75")]
)
def test_quality_tells_clean_windows_from_corrupted_ones(
    recordings: Recordings, kind: str, name: str
) -> None:
    signal, rate = recordings[name], int(name.rpartition("_")[2])
    length = 10 * rate
    signal = signal[: len(signal) // length * length]
    windows = signal.reshape(-1, length)
    # The device of the pulse has 8 bits, and was at their ends in some windows.
    ends = np.isin(windows, (0, 255)).mean(axis=1)
    is_clean = ends < 0.005 if kind == "PPG" else ends < 1
    assert is_clean.mean() > 0.5
    clean = _qualities(kind, signal, rate)[is_clean]
    for added, bad in _corrupted(signal, rate, 15 if kind == "ECG" else 5).items():
        quality = _qualities(kind, bad, rate)[is_clean]
        above, same = clean[:, None] > quality, clean[:, None] == quality
        assert np.mean(above + 0.5 * same) >= 0.9, added
