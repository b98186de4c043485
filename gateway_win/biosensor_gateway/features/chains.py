"""Puts stages together: what is computed from which type of stream."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from biosensor_common.quantities import ContentType
from biosensor_gateway.features import quality
from biosensor_gateway.features import thresholds as at
from biosensor_gateway.features.activity import Activity
from biosensor_gateway.features.breathing import Breathing
from biosensor_gateway.features.heart import Heart
from biosensor_gateway.features.pulse import PulsesOfAnyRate
from biosensor_gateway.features.r_peaks import RPeaks
from biosensor_gateway.features.runs import Array, Event, Hops, Runs, Stage
from biosensor_gateway.features.skin import Skin

_MOST_S = 10.0
"""In blocks no longer than this, qualities are kept until the beats of their time are found."""


class _Beating:
    """Beats of a waveform, and its quality."""

    def __init__(self, content_type: str, find: RPeaks | PulsesOfAnyRate, rate: float) -> None:
        self._quality = quality.Quality(content_type, rate)
        self._find, self._heart = find, Heart(self._quality)
        self._apex_s = math.nan
        self._most = max(1, round(_MOST_S * rate))

    def take(self, stamps: Array, values: Array) -> list[Event]:
        column = values[:, 0]
        events: list[Event] = []
        for begin in range(0, len(stamps), self._most):
            here = slice(begin, begin + self._most)
            # What is told beside a beat is of windows that have ended before it.
            events += self._quality.take(stamps[here], column[here])
            for beat in self._find.take(stamps[here], column[here]):
                events += self._heart.beat(beat.stamp, beat.apex_s - self._apex_s)
                self._apex_s = beat.apex_s
        return events


class _Intervals:
    """Beats that a device tells as intervals, each stamped with the beat that ends it.

    Where the stamps say that beats are missing in between, nothing is bridged.
    """

    def __init__(self) -> None:
        self._heart = Heart()
        self._last: float | None = None

    def take(self, stamps: Array, values: Array) -> list[Event]:
        events: list[Event] = []
        for stamp, interval_s in zip(stamps.tolist(), values.tolist(), strict=True):
            if interval_s <= 0:
                continue  # nothing is dropped: an interval that is not positive is no beat
            if self._last is not None and stamp - self._last > 1.5 * interval_s:
                self._heart = Heart()
            self._last = stamp
            events += self._heart.beat(stamp, interval_s)
        return events


class _Averaged:
    """Has a stage take means of neighbours, each stamped with their middle."""

    def __init__(self, factor: int, stage: Stage) -> None:
        self._hops, self._stage = Hops(factor), stage

    def take(self, stamps: Array, values: Array) -> list[Event]:
        means = [
            ((times[0] + times[-1]) / 2, group.mean(axis=0))
            for times, group in self._hops.take(stamps, values)
        ]
        if not means:
            return []  # nothing is dropped: what makes no mean yet waits in `Hops`
        times, groups = zip(*means, strict=True)
        return self._stage.take(np.array(times), np.array(groups))


class _Together:
    """Several stages on one column."""

    def __init__(self, *stages: Stage) -> None:
        self._stages = stages

    def take(self, stamps: Array, values: Array) -> list[Event]:
        column = values[:, 0]
        return [event for stage in self._stages for event in stage.take(stamps, column)]


def _waveform(
    content_type: str, first: Callable[[float], Stage], rate: float
) -> Callable[[], Stage]:
    return lambda: _Together(first(rate), quality.Quality(content_type, rate))


def new_runs(content_type: str, rate: float, *, foreign: bool) -> Runs:
    """Return what takes the samples of a stream, as they come, and gives events of features.

    Parameters
    ----------
    content_type
        One that :mod:`.outputs` declares features of.
    rate
        Nominal, in Hz, 0 if irregular.
    foreign
        See :class:`.Runs`.
    """
    factor = max(1, math.ceil(rate / at.MOST_HZ))
    slow = rate / factor
    makers: dict[str, Callable[[], Stage]] = {
        ContentType.ECG: lambda: _Beating("ECG", RPeaks(slow), slow),
        ContentType.PPG: lambda: _Beating("PPG", PulsesOfAnyRate(slow), slow),
        ContentType.GSR: _waveform("GSR", Skin, slow),
        ContentType.RESPIRATION: _waveform("Respiration", Breathing, slow),
        ContentType.RR: lambda: _Together(_Intervals()),
        ContentType.ACCELEROMETER: partial(Activity, slow),
    }
    make = makers[content_type]
    if factor > 1:
        return Runs(lambda: _Averaged(factor, make()), rate, foreign=foreign)
    return Runs(make, rate, foreign=foreign)
