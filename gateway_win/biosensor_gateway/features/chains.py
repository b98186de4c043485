"""Combines detectors into a chain for each type of stream."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from biosensor_common.quantities import ContentType
from biosensor_gateway.features import parameters as at
from biosensor_gateway.features import quality
from biosensor_gateway.features.breathing import BR_QUALITY, Breathing
from biosensor_gateway.features.heart import HR_QUALITY, Heart
from biosensor_gateway.features.hidden_beats import ECG_SHAPE, PPG_SHAPE, HiddenBeats
from biosensor_gateway.features.r_peaks import RPeaks
from biosensor_gateway.features.runs import (
    BR_STATE,
    HR_STATE,
    Array,
    Decimator,
    Event,
    Hops,
    Runs,
    Stage,
    State,
)
from biosensor_gateway.features.skin import Skin
from biosensor_gateway.pulses import Beat, Pulses


class PulsesOfAnyRate:
    """Finds pulses at any rate, by averaging faster signals first.

    Parameters
    ----------
    rate
        Nominal rate in Hz.
    """

    def __init__(self, rate: float) -> None:
        self._decimator = Decimator(rate, at.PULSE_RATE_HZ)
        self._pulses = Pulses(self._decimator.rate)

    def take(self, stamps: Array, values: Array) -> list[Beat]:
        """Process stamps and values, both of shape (n,); return the pulses that are certain now."""
        found: list[Beat] = []
        for stamp, value in self._decimator.take(stamps, values):
            found += self._pulses.take(stamp, value)
        return found


class Activity:
    """Gives `activity_live`: the mean amplitude deviation of each epoch, stamped with its end.

    It is the mean absolute deviation of the acceleration's magnitude from its mean, in g, and needs
    no calibration: Vaha-Ypya 2015, see :mod:`.parameters`.

    Parameters
    ----------
    rate
        Nominal rate in Hz; values are three axes in g.
    """

    def __init__(self, rate: float) -> None:
        self._hops = Hops(max(2, round(at.ACTIVITY_EPOCH_S * rate)))

    def take(self, stamps: Array, values: Array) -> list[Event]:
        """Take samples of one run; shapes (n,) and (n, 3)."""
        events: list[Event] = []
        for times, epoch in self._hops.take(stamps, values):
            length = np.sqrt(np.square(epoch).sum(axis=1))
            deviation = float(np.abs(length - length.mean()).mean())
            events.append(Event("activity_live", float(times[-1]), (deviation,)))
        return events


class _EachSecond:
    """Computes beats or breaths of a waveform and its quality, and a state every second.

    Samples are processed second by second, so that results do not depend on how the stream is cut,
    and a beat's quality comes from windows that have ended before it.
    """

    def __init__(self, rate: float, judge: quality.Quality, find: Stage, state: State) -> None:
        self._judge, self._find, self._state = judge, find, state
        self._length = max(1, round(at.STATE_EVERY_S * rate))
        self._count = 0

    def take(self, stamps: Array, values: Array) -> list[Event]:
        column = values[:, 0]
        events: list[Event] = []
        begin = 0
        while begin < len(stamps):
            end = min(len(stamps), begin + self._length - self._count)
            here = slice(begin, end)
            new = self._judge.take(stamps[here], column[here])
            new += self._find.take(stamps[here], column[here])
            events += new
            self._state.note(new)
            self._count += end - begin
            if self._count == self._length:
                self._count = 0
                events.append(self._state.at(float(stamps[end - 1])))
            begin = end
        return events


class _Beating:
    """Finds beats in a waveform, and computes their features."""

    def __init__(
        self, find: RPeaks | PulsesOfAnyRate, hidden: HiddenBeats, trust: quality.Quality
    ) -> None:
        self._find, self._hidden, self._heart = find, hidden, Heart(trust)
        self._apex_s = math.nan

    def take(self, stamps: Array, values: Array) -> list[Event]:
        events: list[Event] = []
        self._hidden.take(stamps, values)
        for beat in self._find.take(stamps, values):
            if beat.doubtful_s:
                self._heart.forget(beat.doubtful_s)
                self._apex_s = math.nan
            hides_beat = self._hidden.is_before(beat.stamp)
            interval_s = beat.apex_s - self._apex_s
            events += self._heart.beat(beat.stamp, interval_s, hides_beat=hides_beat)
            self._apex_s = beat.apex_s
        return events


def _heart(content_type: str, find: RPeaks | PulsesOfAnyRate, rate: float) -> Stage:
    judge = quality.Quality(content_type, rate)
    state = State(HR_STATE, "hr_live", HR_QUALITY, at.INTERVAL_S[1], trust_at=3)
    shape = ECG_SHAPE if content_type == ContentType.ECG else PPG_SHAPE
    beating = _Beating(find, HiddenBeats(rate, shape), judge)
    return _EachSecond(rate, judge, beating, state)


def _breath(rate: float) -> Stage:
    judge = quality.Quality("Respiration", rate)
    state = State(BR_STATE, "br_live", BR_QUALITY, at.BREATH_INTERVAL_S[1])
    return _EachSecond(rate, judge, Breathing(rate), state)


class _Intervals:
    """Computes features of intervals that a device reports, each stamped with its second beat.

    If the stamps show that beats are missing, the windows begin again.
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
    """Passes means of neighbouring samples to a stage, each stamped with their middle."""

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
    """Runs several stages on one channel."""

    def __init__(self, *stages: Stage) -> None:
        self._stages = stages

    def take(self, stamps: Array, values: Array) -> list[Event]:
        column = values[:, 0]
        return [event for stage in self._stages for event in stage.take(stamps, column)]


def new_runs(content_type: str, rate: float, *, foreign: bool) -> Runs:
    """Return the chain that computes the features of a stream.

    Parameters
    ----------
    content_type
        One of `READ_TYPES` of :mod:`.outputs`.
    rate
        Nominal rate in Hz, 0 if irregular.
    foreign
        See :class:`.Runs`.
    """
    factor = max(1, math.ceil(rate / at.MOST_HZ))
    slow = rate / factor
    makers: dict[str, Callable[[], Stage]] = {
        ContentType.ECG: lambda: _heart("ECG", RPeaks(slow), slow),
        ContentType.PPG: lambda: _heart("PPG", PulsesOfAnyRate(slow), slow),
        ContentType.GSR: lambda: _Together(Skin(slow), quality.Quality("GSR", slow)),
        ContentType.RESPIRATION: partial(_breath, slow),
        ContentType.RR: lambda: _Together(_Intervals()),
        ContentType.ACCELEROMETER: partial(Activity, slow),
        # No feature: a temperature only shows whether a sensor is worn.
        ContentType.TEMPERATURE: _Together,
    }
    make, hole_s = makers[content_type], at.HOLE_S.get(content_type, 0.0)
    if factor > 1:
        return Runs(lambda: _Averaged(factor, make()), rate, hole_s=hole_s, foreign=foreign)
    return Runs(make, rate, hole_s=hole_s, foreign=foreign)
