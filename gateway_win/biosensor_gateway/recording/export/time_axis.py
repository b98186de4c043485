"""Finds the sample rate of a regular stream, and where its table must be split."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.xdf.figures import longest_step_s
from biosensor_gateway.recording.xdf.header import RecordedHeader
from biosensor_gateway.recording.xdf.pace import Cuts


@dataclass(slots=True)
class FittedLine:
    """Line fit for samples without gaps, with sums around the means."""

    count: int = 0
    # mean_number, mean_s: the line passes through this point; the first sample has index 0.
    mean_number: float = 0.0
    mean_s: float = 0.0
    # spread, product: sum of squares of the indexes, and sum of products of indexes and times;
    # their quotient is the slope in s per sample.
    spread: float = 0.0
    product: float = 0.0

    def add(self, times: NDArray[np.float64]) -> None:
        """Add the next samples; means and sums are combined as in Chan et al. (1983)."""
        count = len(times)
        number = self.count + np.arange(count, dtype=np.float64)
        mean_number, mean_s = float(number.mean()), float(times.mean())
        total = self.count + count
        weight = self.count * count / total
        away, away_s = mean_number - self.mean_number, mean_s - self.mean_s
        self.spread += float(((number - mean_number) ** 2).sum()) + weight * away**2
        self.product += float((number - mean_number) @ (times - mean_s)) + weight * away * away_s
        self.mean_number += away * count / total
        self.mean_s += away_s * count / total
        self.count = total

    def slope_s(self, usual_s: float) -> float:
        """Return the sample period; the usual one if the line is not plausible."""
        slope_s = self.product / self.spread if self.spread else usual_s
        # A few samples with nearly equal times give a meaningless slope.
        return slope_s if 0.5 < slope_s / usual_s < 2 else usual_s

    def times(self, first: int, count: int, usual_s: float) -> NDArray[np.float64]:
        """Return the times on the line of `count` samples from index `first` on."""
        number = np.arange(first, first + count, dtype=np.float64)
        return self.mean_s + self.slope_s(usual_s) * (number - self.mean_number)


LONGEST_FILLED_S = 3600.0
"""A longer gap is not filled with empty rows; a new table begins after it."""
FURTHEST_BACK_S = 1.0
"""A larger step back means a different clock, so a new table begins."""
# If all timestamps are nearly equal, the fitted rate is meaningless.
_MOST_OFF_NOMINAL = 10.0
# While a clock is unknown, samples may all get the same timestamp, which distorts the line.
_MOST_OFF_MEDIAN = 0.01
_SLOWEST_HZ = 1e-3
_STRETCH_S = 4.0
_LEAST_STRETCH = 16
_DIGITS = 12


@dataclass(slots=True)
class Part:
    """Samples that go into one table."""

    count: int = 0
    start_s: float = 0.0  # Time of the first row.


@dataclass(frozen=True, slots=True)
class Timing:
    """Sample rate, gaps and tables of a regular stream."""

    rate_hz: float  # Rate of the samples between gaps; the nominal rate if it cannot be determined.
    gaps: int  # Steps between timestamps that are too long for adjacent samples.
    longest_gap_s: float
    parts: tuple[Part, ...]  # At least one, in the order of the file.
    rows: float  # Approximate number of rows needed, including empty ones.


@dataclass(slots=True)
class _Survey:
    longest_step_s: float
    longest_filled_s: float
    stretch: int
    """Samples."""
    holes: NDArray[np.int64] | None = None
    """Indexes of the samples after gaps; None if single steps show gaps."""
    stretches_s: array[float] = field(default_factory=lambda: array("d"))
    spread: float = 0.0
    product: float = 0.0
    gaps: int = 0
    longest_gap_s: float = 0.0
    spans_s: float = 0.0
    parts: list[Part] = field(default_factory=list[Part])
    firsts: list[FittedLine] = field(default_factory=list[FittedLine])
    _line: FittedLine = field(default_factory=FittedLine)
    _begin_s: float = 0.0
    _last_s: float = 0.0
    _count: int = 0

    def add(self, times: NDArray[np.float64]) -> None:
        steps = np.diff(times, prepend=self._last_s if self.parts else times[0])
        cuts = (steps > self.longest_filled_s) | (steps < -FURTHEST_BACK_S)
        if not self.parts:
            cuts[0] = True
        begins = np.flatnonzero(cuts | self._is_behind_hole(steps))
        before = 0
        for at in begins.tolist():
            self._extend(times[before:at])
            self._break(float(times[at]), float(steps[at]), is_cut=bool(cuts[at]))
            before = at
        self._extend(times[before:])

    def _is_behind_hole(self, steps: NDArray[np.float64]) -> NDArray[np.bool_]:
        before, self._count = self._count, self._count + len(steps)
        if self.holes is None:
            return steps > self.longest_step_s
        is_behind = np.zeros(len(steps), bool)
        is_behind[self.holes[(self.holes >= before) & (self.holes < self._count)] - before] = True
        return is_behind

    def _extend(self, times: NDArray[np.float64]) -> None:
        if len(times):
            self._line.add(times)
            self.stretches_s.extend(np.diff(times[:: self.stretch]))
            self.parts[-1].count += len(times)
            self._last_s = float(times[-1])

    def _break(self, time_s: float, step_s: float, *, is_cut: bool) -> None:
        self.end_line()
        if not is_cut:
            self.gaps += 1
            self.longest_gap_s = max(self.longest_gap_s, step_s)
            return
        self.end_part()
        self.parts.append(Part())
        self._begin_s = time_s
        self.firsts.append(self._line)

    def end_line(self) -> None:
        self.spread += self._line.spread
        self.product += self._line.product
        self._line = FittedLine()

    def end_part(self) -> None:
        if self.parts:
            self.spans_s += self._last_s - self._begin_s


def find_timing(
    blocks: Iterable[NDArray[np.float64]],
    header: RecordedHeader,
    cuts: Cuts | None = None,
    longest_filled_s: float = LONGEST_FILLED_S,
) -> Timing | None:
    """Determine the timing of a regular stream; None without samples.

    The rate is the common slope of straight lines through the runs, each with its own offset, by
    least squares. If that is far from the median over sections of a few seconds, because
    timestamps are wrong, the median is used. For inexact timestamps of other programs, the rate
    comes from `cuts`. Rows count from the start of the line through the first run.

    Parameters
    ----------
    blocks
        Finite times of the samples in s, each array of shape (n_samples,) and not empty.
    cuts
        Runs of a stream with inexact timestamps, which give its rate and gaps.
    longest_filled_s
        A longer gap starts a new part.
    """
    stretch = max(_LEAST_STRETCH, round(header.rate * _STRETCH_S))
    holes = None if cuts is None else np.array([each.at for each in cuts.holes], np.int64)
    survey = _Survey(longest_step_s(header), longest_filled_s, stretch, holes)
    for times in blocks:
        survey.add(times)
    if not survey.parts:
        return None
    survey.end_line()
    survey.end_part()
    # The header of another program may contain any rate.
    found_hz = 0.0 if cuts is None else 1.0 / cuts.period_s
    if found_hz < _SLOWEST_HZ:
        found_hz = _likely(found_hz or _rate(survey, header.rate), header.rate)
    # More digits would differ between kinds of processors.
    rate_hz = float(f"{found_hz:.{_DIGITS}g}")
    for part, line in zip(survey.parts, survey.firsts, strict=True):
        part.start_s = line.mean_s - line.mean_number / rate_hz
    rows = survey.spans_s * rate_hz + len(survey.parts)
    return Timing(rate_hz, survey.gaps, survey.longest_gap_s, tuple(survey.parts), rows)


def _rate(survey: _Survey, nominal_hz: float) -> float:
    # Two samples are not enough, because the step between them may have any length.
    if survey.spread < 1.0 or survey.product <= 0:
        return nominal_hz
    found_hz = survey.spread / survey.product
    if survey.stretches_s:
        median_s = float(np.median(survey.stretches_s)) / survey.stretch
        if abs(found_hz * median_s - 1.0) > _MOST_OFF_MEDIAN:
            found_hz = 1.0 / median_s if median_s > 0 else nominal_hz
    return found_hz


def _likely(found_hz: float, nominal_hz: float) -> float:
    is_likely = nominal_hz / _MOST_OFF_NOMINAL < found_hz < nominal_hz * _MOST_OFF_NOMINAL
    return found_hz if is_likely else nominal_hz
