"""Hearts whose every beat is known: rhythms, and the ECG or pulse that they make."""

from __future__ import annotations

import numpy as np

from tests.features.signals import Array


def regular(bpm: float, seconds: float, swing: float = 0.03, seed: int = 7) -> Array:
    """Times of beats that breathe, 15 a minute, by `swing` of their interval."""
    return _rhythm(seconds, 60 / bpm, swing, 0.3 * swing, seed)


def arrhythmia(bpm: float, seconds: float, swing: float, per_minute: float = 15.0) -> Array:
    """Times of beats of a strong sinus arrhythmia."""
    return _rhythm(seconds, 60 / bpm, swing, 0.02, 5, per_minute / 60)


def fibrillation(bpm: float, seconds: float, spread: float, seed: int = 3) -> Array:
    """Times of beats that follow each other without order."""
    draw = np.random.default_rng(seed)
    steps = 60 / bpm * (1 + spread * draw.standard_normal(round(3 * seconds * bpm / 60)))
    times = 1.0 + np.cumsum(np.maximum(0.32, steps))
    return times[times < seconds]


def bigeminy(seconds: float) -> Array:
    """Times of beats of which every second one is early, 75 a minute in all."""
    times = np.arange(1.0, seconds, 1.6)
    return np.sort(np.concatenate([times, times + 0.5]))


def _rhythm(
    seconds: float, mean_s: float, swing: float, noise: float, seed: int, breath_hz: float = 0.25
) -> Array:
    draw = np.random.default_rng(seed)
    times = [1.0137]
    while times[-1] < seconds:
        change = swing * np.sin(2 * np.pi * breath_hz * times[-1])
        times.append(times[-1] + mean_s * (1 + change + noise * draw.standard_normal()))
    return np.array(times[:-1])


def ecg_of(beats: Array, rate: float, seconds: float, seed: int = 1) -> Array:
    """Return an ECG in mV with R peaks at these times."""
    t = np.arange(round(seconds * rate)) / rate
    signal = 0.01 * np.random.default_rng(seed).standard_normal(len(t))
    lengths = np.append(np.diff(beats), 0.8)
    for beat, length_s in zip(beats, lengths, strict=True):
        late_s = 0.28 * np.sqrt(min(length_s, 1.2) / 0.85)
        waves = ((0, 0.01, 1.0), (-0.03, 0.009, -0.1), (0.03, 0.009, -0.25), (late_s, 0.04, 0.3))
        _add(signal, t, beat, (*waves, (-0.17, 0.022, 0.12)))
    return signal


def pulse_of(
    beats: Array, rate: float, seconds: float, second: float = 0.35, seed: int = 1
) -> Array:
    """Return pulses of height 1 with tops at these times; the second wave is this high.

    Breathing moves their height and the level by a tenth, so that none is just like another.
    """
    t = np.arange(round(seconds * rate)) / rate
    breath = 0.1 * np.sin(2 * np.pi * 0.21 * t)
    signal = 0.005 * np.random.default_rng(seed).standard_normal(len(t))
    lengths = np.append(np.diff(beats), 0.8)
    for beat, length_s in zip(beats, lengths, strict=True):
        wide = np.sqrt(length_s / 0.8)
        _add(signal, t, beat, ((0, 0.09 * wide, 1.0), (0.28 * wide, 0.11 * wide, second)))
    return signal * (1 + breath) + breath


_Wave = tuple[float, float, float]
"""Centre, width and height."""


def _add(signal: Array, t: Array, beat: float, waves: tuple[_Wave, ...]) -> None:
    for centre, width, height in waves:
        middle = beat + centre
        near = slice(*np.searchsorted(t, [middle - 5 * width, middle + 5 * width]).tolist())
        signal[near] += height * np.exp(-0.5 * ((t[near] - middle) / width) ** 2)


def swing_of(
    seconds: float, rate: float, hertz: float, height: float, uneven: float = 0.0
) -> Array:
    """Return what an arm that swings adds to a pulse; steps differ by `uneven`, heights by more."""
    draw = np.random.default_rng(9)
    steps = np.arange(round(2 * seconds * hertz) + 2)
    lengths_s = (1 + uneven * draw.standard_normal(len(steps) - 1)) / hertz
    t = np.arange(round(seconds * rate)) / rate
    phase = np.interp(t, np.append(0.0, np.cumsum(lengths_s)), steps)
    heights = np.interp(phase, steps, 1 + 5 * uneven * draw.standard_normal(len(steps)))
    first, second = np.sin(2 * np.pi * phase), np.sin(4 * np.pi * phase + 1)
    return height * heights * (first + 0.3 * second)


def artefact(seconds: float, rate: float, moment: float, width_s: float) -> Array:
    """Return one bump of height 1."""
    t = np.arange(round(seconds * rate)) / rate
    return np.exp(-0.5 * ((t - moment) / width_s) ** 2)
