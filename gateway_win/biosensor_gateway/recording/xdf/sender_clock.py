"""Converts timestamps between a stream's clock and the recorder's, by recorded clock offsets.

Every few seconds the recorder measures the offset between its own clock and that of a stream's
computer. EEGLAB's and pyxdf's loaders fit a straight line to these offsets, as the `XDF
specification <https://github.com/sccn/xdf/wiki/Specifications>`_ demands. Here the fit is robust
(Huber's weights, by iterated least squares), because a busy network makes single offsets wrong.
After a restart of the computer or a change of its clock, a separate line follows. Timestamps far
from all measurements, such as Unix time, get the offset without drift.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_common.device_clock import READING_LIMIT_S

JUMP_S = 1.0
"""An offset that changes by more between two measurements means that the clock restarted."""
# A clock was set where offsets change by this much in s, and this many times more than usual; this
# many offsets on either side show whether the change lasts.
_LEAST_STEP_S, _USUAL_CHANGES, _BESIDE = 0.05, 10, 5
LEAST_FOR_DRIFT = 3
"""Fewer offsets are too few to estimate drift; their median is used for all times."""
EXTRAPOLATED_S = 600.0
"""The drift is extrapolated this long before the first and after the last measurement."""
MOST_APART_S = 30 * 86400.0
"""Offsets that put the recorder's clock further apart are not of one recording."""
ASKED_EVERY_S = 5.0
"""From one clock offset to the next."""
# Recorders that round their measurements, and half a tick of Windows' clock, in s.
_ROUNDED_S, _COARSE_S = 1e-6, 5e-8
# Who does not answer this often was away; the second is for measurements that may agree by chance.
_FEWEST, _FEWEST_COARSE = 3, 5
# Samples come soon after the clock offsets of their run, unless a sender stamps by another clock.
_FAR_S = 3600.0

_ROUNDS = 20
# Huber's constant: 95 % as efficient as least squares for normally distributed errors.
_HUBER = 1.345
# Ratio of the standard deviation of normal errors to their median absolute value.
_PER_MEDIAN = 1.4826
_LEAST_SCALE_S = 1e-9


Offset = tuple[float, float]
"""LSL time on the stream's clock, and the offset to the recorder's clock, in s."""


@dataclass(frozen=True, slots=True)
class _Line:
    """Offsets within one run of the clock: `offset + slope * (stamp - middle)`."""

    begin: int
    first: float
    last: float
    middle: float
    offset: float
    slope: float

    def offsets(self, stamps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the offsets of timestamps; drift is extrapolated only for a limited time."""
        return self.offset + self.slope * (np.clip(stamps, *self._ends) - self.middle)

    def stamps(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the timestamps that `offsets` converts to these times."""
        stamps = self.middle + (times - self.middle - self.offset) / (1 + self.slope)
        is_outside = stamps != np.clip(stamps, *self._ends)
        if is_outside.any():
            stamps[is_outside] = times[is_outside] - self.offsets(stamps[is_outside])
        return stamps

    @property
    def _ends(self) -> tuple[float, float]:
        return self.first - EXTRAPOLATED_S, self.last + EXTRAPOLATED_S

    def away(self, stamps: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.maximum(np.maximum(self.first - stamps, stamps - self.last), 0.0)


@dataclass(frozen=True, slots=True)
class DoubtfulSpan:
    """A span in which the sender's clock was set; a timestamp in it may be from before or after."""

    # begin_s, end_s: on the recorder's clock, between the clock offsets on either side.
    begin_s: float
    end_s: float
    # By how much the clock was set; timestamps in the span may be wrong by up to that.
    step_s: float

    def text(self, zero_s: float) -> str:
        """Return a sentence about it, with times since `zero_s`."""
        begin_s, end_s = self.begin_s - zero_s, self.end_s - zero_s
        return (
            f"its sender's clock was set by {self.step_s:.3g} s between {begin_s:.1f} and "
            f"{end_s:.1f} s, so times there may be off by up to that"
        )


class SenderClock:
    """Clock offsets of one stream, over all runs of its clock.

    Parameters
    ----------
    offsets
        Pairs of LSL time on the stream's clock and offset to the recorder's clock, in s, in the
        order of the file. Without any, timestamps stay unchanged.
    """

    def __init__(self, offsets: Sequence[tuple[float, float]]) -> None:
        self._lines = [_fit(begin, run) for begin, run in runs_of(offsets)]
        self._offsets = np.array(offsets, np.float64).reshape(-1, 2)

    @property
    def is_known(self) -> bool:
        """Whether the recorder measured any offset."""
        return bool(self._lines)

    @property
    def restarts(self) -> int:
        """How often the clock restarted."""
        return max(0, len(self._lines) - 1)

    @property
    def unused(self) -> str:
        """The clock offsets that are not used, as the rest of a sentence; empty if all are."""
        is_used = is_plausible(self._offsets)
        if is_used.all():
            return ""
        count = len(is_used) - int(np.count_nonzero(is_used))
        offsets = "1 clock offset is" if count == 1 else f"{count} clock offsets are"
        return (
            f"{offsets} not used, of {len(is_used)}, because no clock differs so much "
            "while it is recorded; compare its times with those of another stream"
        )

    @property
    def doubtful_spans(self) -> list[DoubtfulSpan]:
        """Spans in which the clock was set by so little that the times are uncertain."""
        found: list[DoubtfulSpan] = []
        for before, after in pairwise(self._lines):
            offset_before, offset_after = (
                float(line.offsets(np.array([at]))[0])
                for line, at in ((before, before.last), (after, after.first))
            )
            begin_s, end_s = before.last + offset_before, after.first + offset_after
            # Positive if the sender's own clock went ahead.
            step_s = offset_before - offset_after
            is_told = abs(step_s) > end_s - begin_s
            if step_s < 0:
                # After that, its clock shows the same times once more.
                is_told = is_told and not after.first <= before.last <= after.last
            if not is_told:
                found.append(DoubtfulSpan(begin_s, end_s, step_s))
        return found

    def to_recorder(
        self, stamps: NDArray[np.float64], offsets_before: int = 0
    ) -> NDArray[np.float64]:
        """Return the recorder's time of consecutive samples, in s.

        Parameters
        ----------
        stamps : ndarray of float64, shape (n_samples,)
            On the stream's own clock.
        offsets_before
            Number of clock offsets before them in the file, which identifies the run of the clock.
        """
        if not self._lines or not len(stamps):
            return stamps
        near = self._near(offsets_before)
        offsets = near[0].offsets(stamps)
        for before, line in pairwise(near):
            is_later = line.away(stamps) < before.away(stamps)
            offsets[is_later] = line.offsets(stamps)[is_later]
        if len(self._lines) > len(near):
            self._look_further(stamps, near, offsets)
        return stamps + offsets

    def _look_further(
        self, stamps: NDArray[np.float64], near: Sequence[_Line], offsets: NDArray[np.float64]
    ) -> None:
        """Replace the offsets of timestamps from a clock run long before or after."""
        least_s = np.min([each.away(stamps) for each in near], axis=0)
        for line in self._lines if (least_s > _FAR_S).any() else ():
            away_s = line.away(stamps)
            is_closer = (least_s > _FAR_S) & (away_s < least_s)
            offsets[is_closer] = line.offsets(stamps)[is_closer]
            least_s[is_closer] = np.maximum(away_s[is_closer], np.nextafter(_FAR_S, np.inf))

    def parts(self, times: NDArray[np.float64]) -> list[slice]:
        """Split times on the recorder's clock where the stream's own clock restarted."""
        if len(self._lines) < 2 or not len(times):
            return [slice(0, len(times))]
        away = [each.away(times - each.offset) for each in self._lines]
        cuts = np.flatnonzero(np.diff(np.argmin(away, axis=0))) + 1
        return [slice(begin, end) for begin, end in pairwise([0, *cuts.tolist(), len(times)])]

    def to_sender(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the stream's own time of samples, in s; the inverse of :meth:`to_recorder`.

        Parameters
        ----------
        times : ndarray of float64, shape (n_samples,)
            On the recorder's clock, within one of the :meth:`parts`.
        """
        if not self._lines or not len(times):
            return times
        first = times[:1]
        line = min(self._lines, key=lambda each: float(each.away(first - each.offset)[0]))
        return line.stamps(times)

    def _near(self, offsets_before: int) -> list[_Line]:
        """Return the clock run of samples, or two runs if a new one may begin with them."""
        earlier = [line for line in self._lines if line.begin < offsets_before]
        later = [line for line in self._lines if line.begin >= offsets_before]
        # Samples of a new run may precede its first offset.
        return earlier[-1:] + later[:1]


def runs_of(offsets: Sequence[tuple[float, float]]) -> list[tuple[int, Sequence[Offset]]]:
    """Split offsets where the clock restarted; each run has its index in the file's offsets.

    Values that no clock can show are ignored, see `is_plausible`.
    """
    is_known = is_plausible(np.array(offsets, np.float64).reshape(-1, 2)).tolist()
    known = [(at, *each) for at, each in enumerate(offsets) if is_known[at]]
    begins = [
        number
        for number, (_, time_s, offset) in enumerate(known)
        if number == 0
        # A recorder that loses a sender may note the time before once more, some µs off.
        or time_s < known[number - 1][1] - _LEAST_STEP_S
        or abs(offset - known[number - 1][2]) > JUMP_S
    ]
    ends = [*begins[1:], len(known)] if known else []
    runs = [
        known[first:last]
        for begin, end in zip(begins, ends, strict=True)
        for first, last in pairwise([begin, *_steps(known, begin, end), end])
    ]
    return [(run[0][0], [(time_s, offset) for _, time_s, offset in run]) for run in runs]


class Silence(NamedTuple):
    """Times between which a sender did not answer, in s on the recorder's clock."""

    since_s: float
    until_s: float  # Infinite if it did not answer any more.


def repeats(before: float, offset: float) -> bool:
    """Whether a clock offset is the one before once more, because none could be measured.

    liblsl keeps its last measurement while a sender does not answer, and two measurements never
    agree in all digits. Rounded ones tell nothing.
    """
    return offset == before and not _is_multiple(offset, _ROUNDED_S)


def silences(offsets: Sequence[Offset], end_s: float) -> list[Silence]:
    """Return when a sender did not answer the recorder, from its last answer to the next.

    Parameters
    ----------
    end_s
        When the recorder measured the last clock offset of any stream, on its own clock.
    """
    answers: list[tuple[float, float]] = []  # Times on the recorder's clock, and offsets.
    before = math.nan
    for time_s, value in plausible(offsets):
        if not repeats(before, value):
            answers.append((time_s + value, value))
        before = value
    times_s = [time_s for time_s, _ in answers]
    steps_s = [after - one for one, after in pairwise(times_s)]
    usual_s = max(ASKED_EVERY_S, median(steps_s) if steps_s else 0.0)
    found: list[Silence] = []
    for (since_s, value), until_s in zip(answers, [*times_s[1:], math.inf], strict=False):
        fewest = _FEWEST_COARSE if _is_multiple(value, _COARSE_S) else _FEWEST
        if min(until_s, end_s) - since_s > (fewest - 0.2) * usual_s:
            found.append(Silence(since_s, until_s))
    return found


def plausible(offsets: Sequence[Offset]) -> Sequence[Offset]:
    """Return the clock offsets that can be right, by `is_plausible`."""
    is_good = is_plausible(np.array(offsets, np.float64).reshape(-1, 2)).tolist()
    return [offset for offset, is_one in zip(offsets, is_good, strict=True) if is_one]


def _is_multiple(offset: float, step_s: float) -> bool:
    return abs(offset / step_s - round(offset / step_s)) < 1e-3


def _steps(known: Sequence[tuple[int, float, float]], begin: int, end: int) -> list[int]:
    """Find where a clock was set by less than `JUMP_S`."""
    # A briefly busy network makes single offsets wrong, but the following ones are right again.
    offsets = np.array([offset for _, _, offset in known[begin:end]])
    changes = np.abs(np.diff(offsets))
    if len(changes) < 2 * _BESIDE:
        return []
    least_s = max(_LEAST_STEP_S, _USUAL_CHANGES * float(np.median(changes)))
    found: list[int] = []
    for at in (np.flatnonzero(changes > least_s) + 1).tolist():
        before = offsets[max(found, default=0) : at][-_BESIDE:]
        after = offsets[at : at + _BESIDE]
        if min(len(before), len(after)) < _BESIDE:
            continue
        step_s = abs(float(np.median(after) - np.median(before)))
        if step_s > least_s and max(np.ptp(before), np.ptp(after)) < step_s / _USUAL_CHANGES:
            found.append(at)
    return [begin + at for at in found]


def is_plausible(offsets: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which clock offsets can be right, shape (n,).

    Values that no clock can show come from damage. Where a computer corrects its clock to the date
    while it answers, times on the recorder's clock would be years apart; most of them are right.

    Parameters
    ----------
    offsets : ndarray of float64, shape (n, 2)
    """
    is_good = np.asarray((np.abs(offsets) <= READING_LIMIT_S).all(axis=1))
    known = np.flatnonzero(is_good)
    if not len(known):
        return is_good
    times = offsets[known].sum(axis=1)
    order = np.argsort(times, kind="stable")
    groups = np.split(known[order], np.flatnonzero(np.diff(times[order]) > MOST_APART_S) + 1)
    # Of as many, those that were measured first.
    most = max(groups, key=lambda each: (len(each), -int(each.min())))
    is_good[:] = False
    is_good[most] = True
    return is_good


def is_reading(value: float) -> bool:
    """Whether a clock can show this time, in s."""
    # NaN is not within the limit either.
    return abs(value) <= READING_LIMIT_S


def _fit(begin: int, run: Sequence[tuple[float, float]]) -> _Line:
    times, values = np.array(run).T
    middle = float(times.mean())
    offset, slope = float(np.median(values)), 0.0
    if len(run) >= LEAST_FOR_DRIFT and np.ptp(times) > 0:
        offset, slope = _robust_line(times - middle, values)
    return _Line(begin, float(times.min()), float(times.max()), middle, offset, slope)


def _robust_line(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """Return the intercept and slope of Huber's line."""
    weights = np.ones_like(x)
    offset = slope = 0.0
    for _ in range(_ROUNDS):
        mean_x, mean_y = np.average(x, weights=weights), np.average(y, weights=weights)
        spread = float(weights @ (x - mean_x) ** 2)
        slope = float(weights @ ((x - mean_x) * (y - mean_y))) / spread if spread else 0.0
        offset = float(mean_y - slope * mean_x)
        errors = np.abs(y - offset - slope * x)
        scale = max(_PER_MEDIAN * float(np.median(errors)), _LEAST_SCALE_S)
        weights = np.minimum(1.0, _HUBER * scale / np.maximum(errors, _LEAST_SCALE_S))
    return (offset, slope) if math.isfinite(offset) else (float(np.median(y)), 0.0)
