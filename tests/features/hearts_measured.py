"""How many of the heart rates that are called good are wrong, over many hearts, rates and seeds.

A part of nightly, with another seed each time. By hand: ``python -m tests.features.hearts_measured
SEED [ROW ...]``, which ends with 1 if too much is wrong, and names the cases.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from tests.features import odd_hearts, signals
from tests.features.signals import Array, Case
from tests.features.test_hearts import told_of

SECONDS = 60.0
ECG_HZ = (100.0, 130.0, 200.0, 250.0, 512.0)
PPG_HZ = (25.0, 50.0, 64.0, 100.0, 130.0, 200.0, 250.0, 512.0)
STAMP_S = 0.1
"""So far from its beat a stamp may be."""


class Count(NamedTuple):
    """What was told of a case: of how many good rates how many were wrong, and of stamps."""

    good: int
    wrong: int
    stamps: int
    off: int


def measure(case: Case) -> Count:
    """Count the rates that are called good, and the stamps where these are."""
    events = signals.events_of(case.kind, case.signal, case.rate)
    if not len(case.beats):
        # There is no right rate: each window that is called good is wrong.
        quality = signals.values_of(events, "sqi")[:, 0]
        return Count(len(quality), int(np.count_nonzero(quality >= 0.5)), 0, 0)
    is_told = any(each.feature == "hr_live" for each in events)
    told = told_of(events, case.beats) if is_told else None
    good = told.off_bpm[told.is_good] if told is not None else np.empty(0)
    found = signals.stamps_of(events, "beats")
    found = found[(found > case.since_s) & (found < SECONDS - 1.5)]
    apart = np.array([np.abs(case.beats - each).min() for each in found])
    return Count(
        len(good), int(np.count_nonzero(np.abs(good) > 5)), len(apart), int(np.sum(apart > STAMP_S))
    )


def _waves(name: str, beats: Array, seed: int, noise: float = 0.0) -> Iterator[Case]:
    """Yield ECG and PPG of a heart at the rates of the sensors."""
    for kind, rates in (("ECG", ECG_HZ), ("PPG", PPG_HZ)):
        make = signals.ecg_of if kind == "ECG" else signals.pulse_of
        for rate in rates:
            signal = make(beats, rate, SECONDS, seed=seed)
            signal += noise * np.random.default_rng(seed + 1).standard_normal(len(signal))
            yield Case(f"{name}, {kind} of {rate:g} Hz", kind, rate, signal, beats)


def _pulses(name: str, beats: Array, seed: int, noise: float) -> Iterator[Case]:
    return (each for each in _waves(name, beats, seed, noise) if each.kind == "PPG")


def fibrillation(draw: np.random.Generator) -> Iterator[Case]:
    """Hearts that fibrillate."""
    for spread in (0.18, 0.22, 0.28):
        for bpm in (60, 75, 90, 105, 120):
            seed = int(draw.integers(1 << 30))
            beats = signals.fibrillation(bpm, SECONDS, spread, seed)
            yield from _waves(f"{bpm}/min by {spread}", beats, seed)


def sinus(draw: np.random.Generator) -> Iterator[Case]:
    """Hearts that beat evenly."""
    for bpm in (40, 45, 55, 70, 90, 120, 150, 180, 195):
        for swing in (0.005, 0.03):
            seed = int(draw.integers(1 << 30))
            yield from _waves(f"{bpm}/min", signals.regular(bpm, SECONDS, swing, seed), seed, 0.01)


def arrhythmia(draw: np.random.Generator) -> Iterator[Case]:
    """Hearts whose rate breathes by 30 %."""
    for bpm in (45, 55, 65, 75, 90):
        for breaths in (6, 10, 15):
            seed = int(draw.integers(1 << 30))
            beats = signals.arrhythmia(bpm, SECONDS, 0.3, breaths)
            yield from _waves(f"{bpm}/min, {breaths} breaths", beats, seed)


def slow(draw: np.random.Generator) -> Iterator[Case]:
    """Slow hearts, and noise between the beats of their pulses."""
    for bpm in (26, 28, 30, 32, 34, 36, 38, 42, 46):
        for noise in (0.0, 0.02, 0.05, 0.08, 0.1):
            seed = int(draw.integers(1 << 30))
            beats = signals.regular(bpm, SECONDS, 0.02, seed)
            yield from _pulses(f"{bpm}/min, noise {noise}", beats, seed, noise)
            if not noise:
                for rate in ECG_HZ:
                    signal = signals.ecg_of(beats, rate, SECONDS, seed)
                    yield Case(f"{bpm}/min, ECG of {rate:g} Hz", "ECG", rate, signal, beats)


def second_waves(draw: np.random.Generator) -> Iterator[Case]:
    """Pulses whose second wave is nearly as large as the first, or larger."""
    for second in (0.7, 0.8, 0.9, 1.0, 1.1, 1.25):
        for bpm in (45, 55, 60, 70, 80, 100):
            seed = int(draw.integers(1 << 30))
            beats = signals.regular(bpm, SECONDS, 0.02, seed)
            for rate in PPG_HZ:
                signal = signals.pulse_of(beats, rate, SECONDS, second, seed)
                name = f"{bpm}/min, second wave {second}, {rate:g} Hz"
                yield Case(name, "PPG", rate, signal, beats)


def artefacts(draw: np.random.Generator) -> Iterator[Case]:
    """Pulses, upright and reflected, with one artefact; from 15 s after it on."""
    at_s = 25.0
    for width_s in (0.03, 0.05, 0.15, 0.4, 1.0):
        for height in (3, 10, 30, 100, -3, -10, -30, -100):
            for rate in PPG_HZ:
                seed = int(draw.integers(1 << 30))
                bpm, sign = float(draw.uniform(50, 110)), float(draw.choice([-1, 1]))
                beats = signals.regular(bpm, SECONDS, 0.03, seed)
                moment = at_s + float(draw.uniform(-1, 0))
                signal = sign * signals.pulse_of(beats, rate, SECONDS, seed=seed)
                signal += height * signals.artefact(SECONDS, rate, moment, width_s)
                name = f"{height} times for {width_s} s, sign {sign:g}, {bpm:.0f}/min, {rate:g} Hz"
                yield Case(name, "PPG", rate, signal, beats, at_s + 15)


TURN = 2 * np.pi
LIGHTS: dict[str, Callable[[Array], Array]] = {
    "sine": lambda phase: np.sin(TURN * phase),
    "sine and a fifth": lambda phase: np.sin(TURN * phase) + 0.2 * np.sin(2 * TURN * phase + 1),
    "rectified": lambda phase: np.abs(np.sin(np.pi * phase)),
    "half": lambda phase: np.maximum(0, np.sin(TURN * phase)),
    "saw": lambda phase: 1 - phase % 1,
    "switched": lambda phase: (phase % 1 < 0.3).astype(np.float64),
    "glowing": lambda phase: np.exp(-3 * (phase % 1)),
    "twice": lambda phase: np.sin(TURN * phase) + 1.3 * np.sin(2 * TURN * phase + 1),
}


def lamps(draw: np.random.Generator) -> Iterator[Case]:
    """Light of lamps, and nobody's finger."""
    for name, shape in LIGHTS.items():
        for noise in (0.0, 0.02, 0.05, 0.1):
            for rate in PPG_HZ:
                hertz = float(draw.uniform(0.6, 2.7))
                t = np.arange(30 * rate) / rate
                light = shape(hertz * t + draw.uniform()) + noise * draw.standard_normal(len(t))
                case = f"{name} at {hertz:.2f} Hz, noise {noise}, {rate:g} Hz"
                yield Case(case, "PPG", rate, light * draw.choice([-1, 1]), np.empty(0))


class Row(NamedTuple):
    """A kind of heart: at most this share of good rates, and of stamps, may be wrong."""

    cases: Callable[[np.random.Generator], Iterator[Case]]
    most_wrong: float
    most_off: float = 1.0


ROWS = {
    "fibrillation": Row(fibrillation, 0.04),
    "sinus": Row(sinus, 0.0, 0.0),
    "arrhythmia": Row(arrhythmia, 0.02),
    "slow": Row(slow, 0.0),
    "second waves": Row(second_waves, 0.0),
    "artefacts": Row(artefacts, 0.0, 0.0),
    "lamps": Row(lamps, 0.0),
    "held values": Row(odd_hearts.held_values, 0.0),
    "sent twice": Row(odd_hearts.sent_twice, 0.04),
}
BY_HAND = {name: Row(cases, 1.0) for name, cases in odd_hearts.KINDS.items()} | ROWS
"""Also those of which nothing is claimed yet."""


def wrong_ones(name: str, seed: int) -> tuple[Count, list[str]]:
    """Return the sum over a row's cases, and those in which something is wrong."""
    counts: list[Count] = []
    told: list[str] = []
    for case in BY_HAND[name].cases(np.random.default_rng(seed)):
        counts.append(measure(case))
        if counts[-1].wrong or counts[-1].off:
            told.append(f"{case.name}: {counts[-1]}")
    return Count(*(sum(each) for each in zip(*counts, strict=True))), told


def main() -> int:
    """Print each row; return 1 if in one of them too much is wrong."""
    is_right = True
    for name in sys.argv[2:] or ROWS:
        total, told = wrong_ones(name, int(sys.argv[1]))
        most_wrong, most_off = BY_HAND[name].most_wrong, BY_HAND[name].most_off
        holds = total.wrong <= most_wrong * total.good and total.off <= most_off * total.stamps
        is_right = is_right and holds
        print(f"{name}, {'holds' if holds else 'BROKEN'}: {total}, {len(told)} cases are not right")
        print(*(f"    {each}" for each in told), sep="\n", flush=True)
    return 0 if is_right else 1


if __name__ == "__main__":
    sys.exit(main())
