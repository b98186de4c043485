"""Wearers whose hearts and breath are steered: every virtual device can be worn by them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np

from biosensor_gateway.simulation.wearer import Floats, Wearer

_ECTOPIC_SHARE = 0.6
"""A beat out of turn comes after this part of an interval; the pause behind makes up for it."""
_SHORTEST_S = 0.32
"""No heart beats sooner again."""
Span = tuple[float, float]
"""From when until when [s]."""


@dataclass(frozen=True)
class Patient(Wearer):
    """A person with given beats, who may hold the breath and walk."""

    # When R peaks are, ascending; before and behind them the heart beats as at the ends.
    beats_s: tuple[float, ...] = ()
    # apnoeas, walks: when nothing is breathed, and when two steps a second are walked.
    apnoeas: tuple[Span, ...] = ()
    walks: tuple[Span, ...] = ()

    def heart_rate(self, t: Floats) -> Floats:
        """Momentary heart rate [1/min]: that of the interval in which a time is."""
        beats = np.floor(self.beat_count(t))
        return np.asarray(60 / (self.beat_time(beats + 1) - self.beat_time(beats)), np.float64)

    def beat_count(self, t: Floats) -> Floats:
        """Beats until ``t``, with fractions."""
        return np.interp(t, self._times, self._numbers)

    def beat_time(self, beats: Floats) -> Floats:
        """When R peaks happen [s]."""
        return np.interp(beats, self._numbers, self._times)

    def chest_force_n(self, t: Floats) -> Floats:
        """Tension of a belt, which keeps still without breath [N]."""
        still = 12.0 + self.noise(t, 0.02, "belt")
        breathing = super().chest_force_n(t)
        breathing[_within(t, self.apnoeas)] = still[_within(t, self.apnoeas)]
        return breathing

    def acceleration_g(self, t: Floats) -> Floats:
        """Acceleration of the trunk, with steps [g]."""
        steps = np.where(_within(t, self.walks), 0.4 * np.sin(2 * pi * 2.0 * t), 0.0)
        return super().acceleration_g(t) + steps[:, np.newaxis]

    @cached_property
    def _times(self) -> Floats:
        known = np.array(self.beats_s, np.float64)
        around = np.arange(1.0, 1001.0)
        before = known[0] - (known[1] - known[0]) * around[::-1]
        return np.concatenate((before, known, known[-1] + (known[-1] - known[-2]) * around))

    @cached_property
    def _numbers(self) -> Floats:
        return np.arange(-1000.0, len(self._times) - 1000.0, dtype=np.float64)


def ramp(seconds: float, from_bpm: float, to_bpm: float) -> tuple[float, ...]:
    """Return beats whose rate goes from one to another, evenly in time."""
    times = [0.0]
    while times[-1] < seconds:
        times.append(times[-1] + 60 / (from_bpm + (to_bpm - from_bpm) * times[-1] / seconds))
    return tuple(times)


def fibrillation(seconds: float, bpm: float, seed: int = 3) -> tuple[float, ...]:
    """Return beats that follow each other without order."""
    draw = np.random.default_rng(seed)
    steps = 60 / bpm * (1 + 0.25 * draw.standard_normal(round(3 * seconds * bpm / 60)))
    times = np.cumsum(np.maximum(_SHORTEST_S, steps))
    return tuple(times[times < seconds].tolist())


def ectopic(seconds: float, bpm: float, every: int) -> tuple[float, ...]:
    """Return even beats of which each so many comes out of turn."""
    interval_s = 60 / bpm
    numbers = np.arange(round(seconds / interval_s))
    is_early = numbers % every == every - 1
    return tuple((interval_s * (numbers - (1 - _ECTOPIC_SHARE) * is_early)).tolist())


def _within(t: Floats, spans: tuple[Span, ...]) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    inside = np.zeros(len(t), np.bool_)
    for begin_s, end_s in spans:
        inside |= (t >= begin_s) & (t < end_s)
    return inside
