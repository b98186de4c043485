"""Signals with known events, made of formulas and seeds, and stamps for them."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.features.chains import new_runs
from biosensor_gateway.features.runs import Event

Array = NDArray[np.float64]


class Case(NamedTuple):
    """A signal, and when its heart beats; nothing where there is none."""

    name: str
    kind: str
    rate: float
    signal: Array
    beats: Array
    since_s: float = 12.0


# Centre, width and height of P, Q, R, S and T around the R peak, in s and mV.
_WAVES = (
    (-0.18, 0.025, 0.12),
    (-0.03, 0.009, -0.1),
    (0.0, 0.01, 1.0),
    (0.03, 0.009, -0.2),
    (0.26, 0.04, 0.3),
)


def beat_times(seconds: float, seed: int = 1, mean_s: float = 0.8) -> Array:
    """Times of beats that breathe: 12 a minute, by 6 %."""
    draw = np.random.default_rng(seed)
    times = [0.5]
    while times[-1] < seconds:
        swing = 0.06 * np.sin(2 * np.pi * 0.2 * times[-1]) + 0.01 * draw.standard_normal()
        times.append(times[-1] + mean_s * (1 + swing))
    return np.array(times[:-1])


def ecg(rate: float, seconds: float, seed: int = 1) -> tuple[Array, Array]:
    """Return an ECG in mV with a little noise, and the times of its R peaks."""
    t = np.arange(round(seconds * rate)) / rate
    beats = beat_times(seconds, seed)
    signal = 0.01 * np.random.default_rng(seed).standard_normal(len(t))
    for beat in beats:
        near = slice(*np.searchsorted(t, [beat - 0.4, beat + 0.6]).tolist())
        for centre, width, height in _WAVES:
            signal[near] += height * np.exp(-0.5 * ((t[near] - beat - centre) / width) ** 2)
    return signal, beats


def pulse(rate: float, seconds: float) -> tuple[Array, Array]:
    """Return pulses of a finger, and the times of their tops."""
    t = np.arange(round(seconds * rate)) / rate
    beats = beat_times(seconds)
    signal = 0.1 * np.sin(2 * np.pi * 0.1 * t)
    for beat in beats:
        near = slice(*np.searchsorted(t, [beat - 0.5, beat + 1.0]).tolist())
        width = np.where(t[near] < beat, 0.08, 0.13)
        signal[near] += np.exp(-0.5 * ((t[near] - beat) / width) ** 2)
        # Real pulses have a second wave.
        signal[near] += 0.3 * np.exp(-0.5 * ((t[near] - beat - 0.33) / 0.07) ** 2)
    return signal, beats


def skin(rate: float, seconds: float) -> tuple[Array, Array]:
    """Return skin conductance in uS with a response every 15 s, and the times of its peaks."""
    t = np.arange(round(seconds * rate)) / rate
    onsets = np.arange(12.0, seconds - 6, 15.0)
    signal = 5.0 - 0.002 * t
    for onset in onsets:
        s = np.maximum(0.0, t - onset)
        signal += 0.5 * (np.exp(-s / 4) - np.exp(-s / 0.75)) / 0.58
    # Where the difference of two exponentials is the largest.
    return signal, onsets + np.log(4 / 0.75) * 4 * 0.75 / (4 - 0.75)


def breath(rate: float, seconds: float, per_minute: float = 15.0) -> Array:
    """Return the force of a belt in N."""
    t = np.arange(round(seconds * rate)) / rate
    return 20.0 + 3.0 * np.sin(2 * np.pi * per_minute / 60 * t) + 0.01 * t


def breaths(
    rate: float, seconds: float, per_minute: float, *, coughs: bool, seed: int = 0
) -> tuple[Array, Array]:
    """Return breaths of varying length and depth, some of them sighs, and their tops.

    The level wanders, the heart beats in it, and somebody coughs or moves once a minute if told.
    """
    draw = np.random.default_rng(seed)
    bounds = [0.0]
    while bounds[-1] < seconds:
        bounds.append(bounds[-1] + 60 / per_minute * np.exp(0.15 * draw.standard_normal()))
    t = np.arange(round(seconds * rate)) / rate
    signal = 0.5 * np.sin(2 * np.pi * 0.01 * t) + 0.05 * np.sin(2 * np.pi * 1.1 * t)
    signal += 0.02 * draw.standard_normal(len(t))
    for begin, end in pairwise(bounds):
        depth = np.exp(0.3 * draw.standard_normal()) * (3 if draw.random() < 0.03 else 1)
        here = (t >= begin) & (t < end)
        part = (t[here] - begin) / (end - begin)
        rises = (1 - np.cos(np.pi * part / 0.4)) / 2
        falls = (1 + np.cos(np.pi * np.minimum(1, (part - 0.4) / 0.5))) / 2
        signal[here] += depth * np.where(part < 0.4, rises, falls)
    for moment in draw.uniform(0, seconds, round(seconds / 60) if coughs else 0):
        signal += draw.choice([-3, 3]) * np.exp(-(((t - moment) / 0.4) ** 2))
    begins, ends = np.array(bounds[:-1]), np.array(bounds[1:])
    return signal, begins + 0.4 * (ends - begins)


def events_of(
    kind: str, values: Array, rate: float, cuts: list[int] | None = None, begin_s: float = 100.0
) -> list[Event]:
    """Return what is computed of a signal that comes in these blocks; else in one."""
    runs = new_runs(kind, rate, foreign=False)
    columns = values.reshape(len(values), -1)
    stamps = begin_s + np.arange(len(values)) / rate
    bounds = [0, *sorted({min(cut, len(values)) for cut in cuts or []}), len(values)]
    return [
        event
        for begin, end in pairwise(bounds)
        for event in runs.take(stamps[begin:end], columns[begin:end])
    ]


def stamps_of(events: list[Event], feature: str, begin_s: float = 100.0) -> Array:
    return np.array([each.stamp - begin_s for each in events if each.feature == feature])


def values_of(events: list[Event], feature: str) -> Array:
    return np.array([each.values for each in events if each.feature == feature])


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
    beats: Array,
    rate: float,
    seconds: float,
    second: float = 0.35,
    seed: int = 1,
    heights: Array | None = None,
) -> Array:
    """Return pulses of height 1, or these, with tops at these times; the second wave is this high.

    Breathing moves their height and the level by a tenth, so that none is just like another.
    """
    t = np.arange(round(seconds * rate)) / rate
    breath = 0.1 * np.sin(2 * np.pi * 0.21 * t)
    signal = 0.005 * np.random.default_rng(seed).standard_normal(len(t))
    lengths = np.append(np.diff(beats), 0.8)
    sizes = np.ones(len(beats)) if heights is None else heights
    for beat, length_s, size in zip(beats, lengths, sizes, strict=True):
        wide = np.sqrt(length_s / 0.8)
        _add(signal, t, beat, ((0, 0.09 * wide, size), (0.28 * wide, 0.11 * wide, size * second)))
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
