"""Combines detectors into a chain for each type of stream."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from biosensor_common.quantities import ContentType
from biosensor_gateway.features import parameters as at
from biosensor_gateway.features import quality
from biosensor_gateway.features.breathing import BR_QUALITY, Breathing
from biosensor_gateway.features.heart import HR_QUALITY, Heart
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


class Shape(NamedTuple):
    """What is compared of a beat, and where one can be hidden."""

    rate_hz: float
    around_s: float  # How much of a beat is compared, before and after its apex.
    early_s: float  # So long after a beat another one is possible,
    after_s: float  # so long after it its own waves have ended,
    before_s: float  # and so long before one they begin.
    is_either_way: bool  # Whether a beat may point down.
    order: int  # Of the polynomial that beats lie upon: a level that changes, or a T wave.
    # Whatever is as large as this share of a beat is one, too, after this time; never if NaN.
    other_share: float
    other_after_s: float


class HiddenBeats:
    """Looks between two beats for a smaller one of the same shape.

    Every second beat may be small: in bigeminy, in alternans, or where an early beat moves little
    blood. A detector with one threshold then gives half of the rate, from a signal without noise.

    Parameters
    ----------
    rate
        Nominal rate in Hz.
    """

    def __init__(self, rate: float, shape: Shape) -> None:
        self._shape = shape
        self._decimator = Decimator(rate, shape.rate_hz)
        slow = self._decimator.rate
        self._around = max(2, round(shape.around_s * slow))
        size = round(at.HIDDEN_KEPT_S * slow)
        # nothing is dropped: what was looked at between two beats
        self._stamps: deque[float] = deque(maxlen=size)
        self._values: deque[float] = deque(maxlen=size)  # nothing is dropped: as the stamps
        # nothing is dropped: a memory of beats
        self._beats: deque[Array] = deque(maxlen=at.PEAKS_KEPT)
        self._last_s = np.nan

    def take(self, stamps: Array, values: Array) -> None:
        """Take samples of one run in; both of shape (n,)."""
        for stamp, value in self._decimator.take(stamps, values):
            self._stamps.append(stamp)
            self._values.append(value)

    def is_before(self, beat_s: float) -> bool | None:
        """Return whether there seems to be a beat between the last one and this one.

        None while it is not known what beats are like.
        """
        last_s, self._last_s = self._last_s, beat_s
        if not beat_s - last_s > self._shape.early_s + self._shape.before_s:
            return False  # nothing is dropped: the first one, or no place for another
        stamps, values = np.array(self._stamps), np.array(self._values)
        width = 2 * self._around + 1
        if len(values) < width:
            return None
        plain = np.lib.stride_tricks.sliding_window_view(values, width)
        windows = _straightened(plain, self._shape.order)
        middles = stamps[self._around : len(stamps) - self._around]
        # The sample that is nearest to the beat before.
        place = int(np.abs(middles - last_s).argmin())
        if middles[0] < last_s:
            self._beats.append(windows[place])
        if len(self._beats) < at.TEMPLATE_LEAST:
            return None
        beat = np.median(list(self._beats), axis=0)
        size = float(np.sqrt(np.square(beat).sum()))
        until = middles < beat_s - self._shape.before_s
        if not size > 0:
            return False
        # The slower a heart, the later the waves of its beats.
        later = math.sqrt(max(1.0, (beat_s - last_s) / at.HIDDEN_SLOW_S))
        is_here = (middles > last_s + later * self._shape.early_s) & until
        here, is_early = windows[is_here], middles[is_here] < last_s + later * self._shape.after_s
        sizes = np.sqrt(np.square(here).sum(axis=1))
        alike = here @ beat / size / np.maximum(sizes, 1e-9 * size)
        if self._shape.is_either_way:
            alike = np.abs(alike)
        else:
            # It has a top, which the slope behind another wave has not.
            near = slice(self._around // 2, width - self._around // 2)
            middle = plain[is_here, near]
            alike[middle.max(axis=1) <= np.maximum(middle[:, 0], middle[:, -1])] = 0.0
        early = at.HIDDEN_EARLY_ALIKE if self._is_narrow(beat) else np.inf
        least = np.where(is_early, early, at.HIDDEN_ALIKE)
        is_like = (sizes >= at.HIDDEN_SHARE * size) & (alike >= least)
        # Wide beats, as of the ventricles, differ little from the bow of a T wave.
        other = _straightened(plain[(middles > last_s + self._shape.other_after_s) & until], 1)
        is_large = np.ptp(other, axis=1) > self._shape.other_share * np.ptp(beat)
        return bool(is_like.any() or is_large.any())

    def _is_narrow(self, beat: Array) -> bool:
        near = max(1, round(at.NARROW_S * self._decimator.rate))
        inside = beat[self._around - near : self._around + near + 1]
        return bool(np.square(inside).sum() >= at.NARROW_SHARE * np.square(beat).sum())


def _straightened(windows: Array, order: int) -> Array:
    """Return windows without the polynomial that is nearest to them; shape (n, width)."""
    line = np.linspace(-1.0, 1.0, windows.shape[1])
    base, _ = np.linalg.qr(np.vander(line, order + 1))
    return windows - windows @ base @ base.T


ECG_SHAPE = Shape(
    rate_hz=at.TEMPLATE_RATE_HZ,
    around_s=0.08,
    early_s=0.25,
    after_s=0.4,
    before_s=0.25,
    is_either_way=True,
    order=2,
    other_share=0.4,
    other_after_s=0.5,
)
"""A T wave is over after 0.4 s, or has another shape than a QRS complex; a P wave begins up to
0.25 s before one."""
PPG_SHAPE = Shape(
    rate_hz=50.0,
    around_s=0.2,
    early_s=0.48,
    after_s=0.48,
    before_s=0.35,
    is_either_way=False,
    order=1,
    other_share=np.nan,
    other_after_s=0.48,
)
"""The second wave of a pulse is 0.3 to 0.45 s after the first."""


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
