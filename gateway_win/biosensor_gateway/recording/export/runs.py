"""Finds the runs of a regular stream: samples without gaps between them."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.exporter import Times
from biosensor_gateway.recording.export.time_axis import FittedLine
from biosensor_gateway.recording.xdf.figures import cuts_of, longest_step_s
from biosensor_gateway.recording.xdf.pace import MOST_LOST, STEP_BACK_S, Cuts, stray_text

_BATCHES_IN_SECTION = 64


# The exports' cost depends on the number of calls, so the samples of many chunks are joined.
def batches(chosen: Chosen, stream: Stream) -> Iterator[Samples]:
    """Yield the samples of a stream, many chunks of the file at once."""
    least = max(1, chosen.batch // stream.header.channel_count)
    kept: list[Samples] = []
    count = 0
    for samples in chosen.samples(stream):
        kept.append(samples)
        count += len(samples)
        if count >= least:
            yield joined(kept)
            kept, count = [], 0
    if kept:
        yield joined(kept)


def section(chosen: Chosen) -> int:
    """Return how many samples of a stream are analysed together to find its runs."""
    return _BATCHES_IN_SECTION * chosen.batch


def joined(parts: Sequence[Samples]) -> Samples:
    """Join consecutive samples of one stream."""
    times = np.concatenate([each.times for each in parts])
    stamps = np.concatenate([each.stamps for each in parts])
    texts = [text for each in parts if isinstance(each.values, list) for text in each.values]
    arrays = [each.values for each in parts if not isinstance(each.values, list)]
    return Samples(times, stamps, np.concatenate(arrays) if arrays else texts)


MOST_RUNS = 999
"""Nobody opens more files of one stream."""
_MOST_JOINED = 100_000
"""A stream with more runs has invalid timestamps rather than gaps."""
BAD_GAP = "BAD_gap"
"""Name of the event for a gap; MNE excludes data that such events cover."""
LONGEST_JOINED_S = 3600.0
"""A longer gap always starts a new file."""
_MOST_RATES = 3
_TOLD_AWAY_S = 1e-3


@dataclass(slots=True)
class Run:
    """Samples without gaps between them.

    Attributes
    ----------
    count
        Number of samples; at least one.
    begin_s, end_s
        Times of the first and last sample on the recorder's clock.
    least, greatest : ndarray of float64, shape (n_channels,)
        Range of the finite values; infinite where there are none.
    period_s
        Sample period, if it cannot be taken from the times; else 0.
    lost
        Estimated number of samples missing before it; 0 also where time steps back.
    """

    count: int
    begin_s: float
    end_s: float
    least: NDArray[np.float64]
    greatest: NDArray[np.float64]
    period_s: float = 0.0
    lost: int = 0

    @property
    def length_s(self) -> float:
        """Time from the first to the last sample."""
        return (self.count - 1) * self.period_s if self.period_s else self.end_s - self.begin_s

    def rate_hz(self, nominal_hz: float) -> float:
        """Return the nominal rate if it fits the times to half a sample, else the measured."""
        length_s, steps = self.length_s, self.count - 1
        if not steps or length_s <= 0 or abs(length_s * nominal_hz - steps) < 0.5:
            return nominal_hz
        return steps / length_s


def longest_gap_s(times: Times) -> float:
    """Return the longest gap after which a file continues."""
    return LONGEST_JOINED_S if times is Times.EVEN else 0.0


def on_line(
    chosen: Chosen, stream: Stream, times: Times, *, always: bool = False
) -> tuple[Runs | None, Cuts | None]:
    """Return the runs of a stream whose rows lie on lines; None if the stamps determine the rows.

    Parameters
    ----------
    always
        Also if another program's stamps are only a little inexact.

    Returns
    -------
    tuple
        The runs, and in either case where they begin; None if single steps show it.
    """
    if has_even_times(stream, times):
        runs = Runs(chosen, stream, times)
        return runs, runs.cuts
    if stream.header.has_exact_stamps or not stream.header.is_regular:
        return None, None
    runs = Runs(chosen, stream, Times.EVEN)
    # To find the cuts costs a pass through all samples, so the caller gets them also without runs.
    return runs if always or runs.is_uneven else None, runs.cuts


def has_even_times(stream: Stream, times: Times) -> bool:
    """Whether the samples of a stream get evenly spaced times."""
    return times is Times.EVEN and stream.header.is_regular and not stream.header.is_markers


class Gap(NamedTuple):
    """A gap in s, with the estimated number of missing samples."""

    begin_s: float
    length_s: float
    lost: int

    @property
    def text(self) -> str:
        """Its description in words."""
        samples = "1 sample is" if self.lost == 1 else f"{self.lost} samples are"
        return f"about {samples} missing for {self.length_s:.6g} s"


class Runs:
    """The runs of one regular stream.

    In our own streams, and in others whose header says that samples may be missing, a run ends
    where the next timestamp is too late, or earlier than the last one. In other streams it ends
    where the line through the earliest timestamps jumps (`recording.xdf.pace`), and samples have
    the times of that line: a first packet that came late would shift the whole run otherwise.

    Parameters
    ----------
    times
        Even times lie on one straight line per run; where timestamps are exact, it is fitted by
        least squares.

    Attributes
    ----------
    cuts
        Starts of the runs; None if single steps show them.
    moved_s
        Largest difference between even and recorded times so far, without outliers.
    stray
        Number of outliers: timestamps far from those before and after.
    """

    def __init__(self, chosen: Chosen, stream: Stream, times: Times = Times.RECORDED) -> None:
        self._chosen, self._stream = chosen, stream
        self._is_even = times is Times.EVEN
        # Where stamps tell nothing, one sample follows the other, as far as anybody knows.
        given = () if stream.order_error else (each.times for each in batches(chosen, stream))
        self.cuts = cuts = cuts_of(given, stream.header, section(chosen))
        self._usual_s = cuts.period_s if cuts else 1.0 / stream.header.rate
        self._lost_at = {each.at: each.lost for each in cuts.holes} if cuts else {}
        self._stray = np.array(cuts.stray if cuts else [], np.int64)
        self._lost: dict[int, int] = {}
        self._counts: dict[int, int] = {}
        self._lines: list[FittedLine] = []
        self.stray, self.moved_s = len(self._stray), 0.0
        if self._is_even and cuts is None:
            self._fit()

    @property
    def most(self) -> int:
        """Number of runs that are written; many more where a gap does not end a file."""
        return _MOST_JOINED if self._is_even else MOST_RUNS

    def left_out(self, runs: int, files: int) -> str:
        """Return why so many runs, in so many files, are not written; empty if they are."""
        if runs <= self.most and files <= MOST_RUNS:
            return ""
        most = self.most if runs > self.most else MOST_RUNS
        hint = "" if self._is_even else "; with even times, a gap does not end a file"
        return f"left out, because it has more than {most} gaps{hint}"

    @property
    def is_uneven(self) -> bool:
        """Whether single timestamps are not times of measurement."""
        pace = self.cuts.pace if self.cuts else None
        return pace is not None and bool(
            pace.burst > 1 or pace.overlap_s > 0 or pace.standstills or self.stray
        )

    def pieces(self) -> Iterator[tuple[int, Samples]]:
        """Yield the samples in blocks, each with the number of its run."""
        done = 0
        for number, first, samples in self._recorded():
            times = self._on_line(number, first, len(samples))
            if times is None:
                yield number, samples
                continue
            away = np.abs(times - self._in_line(samples.times, done))
            self.moved_s = max(self.moved_s, float(away.max()))
            done += len(samples)
            yield number, replace(samples, times=times)

    def samples(self) -> Iterator[Samples]:
        """Yield the samples in order."""
        for _, samples in self.pieces():
            yield samples

    def found(self) -> list[Run]:
        """Return all runs of a numeric stream; at most one more than `most`."""
        found: list[Run] = []
        for number, samples in self.pieces():
            values = np.asarray(samples.values, np.float64)
            is_finite = np.isfinite(values)
            least = np.where(is_finite, values, np.inf).min(axis=0)
            greatest = np.where(is_finite, values, -np.inf).max(axis=0)
            begin_s, end_s = float(samples.times[0]), float(samples.times[-1])
            if number == len(found):
                if number > self.most:
                    break
                period_s, lost = self._period_s(number), self._lost.get(number, 0)
                found.append(Run(len(samples), begin_s, end_s, least, greatest, period_s, lost))
                continue
            run = found[-1]
            run.count += len(samples)
            run.end_s = end_s
            run.least = np.minimum(run.least, least)
            run.greatest = np.maximum(run.greatest, greatest)
        return found

    def gaps(self) -> list[Gap]:
        """Return the gaps between evenly spaced times."""
        gaps: list[Gap] = []
        for number, lost in self._lost.items():
            before = self._on_line(number - 1, self._counts[number - 1], 1)
            behind = self._on_line(number, 0, 1)
            if lost and before is not None and behind is not None:
                gaps.append(Gap(float(before[0]), max(0.0, float((behind - before)[0])), lost))
        return gaps

    def remarks(self, files: Sequence[Stretch], instead: str) -> Iterator[str]:
        """Yield sentences about the handling of timestamps and gaps.

        Parameters
        ----------
        files
            Files of the runs.
        instead
            What is written where nothing was measured, in words.
        """
        yield from self.remarks_on_times()
        nominal_hz = self._stream.header.rate
        rates = dict.fromkeys(f"{each.rate_hz:.6g}" for each in files if each.rate_hz != nominal_hz)
        if self.cuts and rates:
            told = ", ".join(list(rates)[:_MOST_RATES]) + (
                ", ..." if len(rates) > _MOST_RATES else ""
            )
            yield f"its rate is {told} Hz, the rate of a line through its timestamps"
        lost = [run.lost for each in files for run in each.runs if run.lost]
        inside = sum(rows > 0 for each in files for rows in each.empty)
        if lost:
            yield gap_text(lost)
        if inside:
            yield f"events {BAD_GAP} mark where it continues after a gap; {instead} there"
        if len(files) > 1:
            runs = [run for each in files for run in each.runs]
            steps = [
                after.begin_s < before.begin_s for before, after in pairwise(runs) if not after.lost
            ]
            cuts = ["gaps"] * bool(lost) + ["steps back in time"] * any(steps)
            cuts += ["steps to another clock"] * (not all(steps))
            why = " and ".join(cuts) or "gaps"
            yield f"{why} cut it into {len(files)} files"
        if inside and (away_s := max(each.away_s for each in files)) > max(
            _TOLD_AWAY_S, 1.0 / nominal_hz
        ):
            yield f"a file has one rate, so samples are up to {round(away_s * 1e3, 3):g} ms off"

    def remarks_on_times(self) -> Iterator[str]:
        """Yield sentences about the difference between even and recorded times."""
        moved_ms = round(self.moved_s * 1e3, 3)
        if self._is_even:
            yield f"even times are at most {moved_ms:g} ms from the recorded ones"
        elif self.cuts and self.moved_s > max(_TOLD_AWAY_S, self.cuts.period_s):
            yield (
                f"its times are those of a line through its earliest stamps, at most {moved_ms:g} "
                f"ms from the recorded ones{self._why_uneven}"
            )
        if self.stray:
            yield stray_text(self.stray)
        if self.cuts and self.cuts.pace and (stood := self.cuts.pace.standstills):
            count = sum(each.count for each in stood)
            yield f"its clock stood still for {count} samples, which have the times of the line"

    @property
    def _why_uneven(self) -> str:
        pace = self.cuts.pace if self.cuts else None
        if pace is not None and pace.burst > 1:
            return f", for they come in bursts of {pace.burst}"
        return ", for they are arrival times" if pace is not None and pace.overlap_s > 0 else ""

    def _on_line(self, number: int, first: int, count: int) -> NDArray[np.float64] | None:
        """Return the times of a run's samples on its line; None if the recorded times are used."""
        if self.cuts is not None:
            return self.cuts.times(number, first, count)
        return self._lines[number].times(first, count, self._usual_s) if self._is_even else None

    def _period_s(self, number: int) -> float:
        if self.cuts is not None:
            return self.cuts.period_s
        return self._lines[number].slope_s(self._usual_s) if self._is_even else 0.0

    def _fit(self) -> None:
        done = 0
        for number, _, samples in self._recorded():
            if number == len(self._lines):
                self._lines.append(FittedLine())
            self._lines[number].add(self._in_line(samples.times, done))
            done += len(samples)

    def _in_line(self, times: NDArray[np.float64], before: int) -> NDArray[np.float64]:
        """Return the times with outliers replaced by interpolation."""
        is_here = (self._stray >= before) & (self._stray < before + len(times))
        if not is_here.any() or is_here.sum() == len(times):
            return times
        is_good = np.ones(len(times), bool)
        is_good[self._stray[is_here] - before] = False
        place = np.arange(len(times))
        return np.interp(place, place[is_good], times[is_good])

    def _recorded(self) -> Iterator[tuple[int, int, Samples]]:
        """Yield the samples as recorded, with their run and the number of earlier samples in it."""
        run = count = first = 0
        last_s: float | None = None
        for samples in batches(self._chosen, self._stream):
            cuts = self._in_batch(samples.times, last_s, count)
            last_s, count = float(samples.times[-1]), count + len(samples)
            for begin, end in pairwise([0, *cuts, len(samples)]):
                # No samples precede a cut at the start of a batch.
                if begin == end:
                    continue
                if begin in cuts:
                    run, first = run + 1, 0
                    self._lost[run] = cuts[begin]
                yield run, first, _part(samples, begin, end)
                first += end - begin
                self._counts[run] = first

    def _in_batch(
        self, times: NDArray[np.float64], last_s: float | None, before: int
    ) -> dict[int, int]:
        """Return the samples of a batch at which runs begin, and how many are missing before each.

        Parameters
        ----------
        before
            Number of samples before the batch.
        """
        if self.cuts is not None:
            numbers = self.cuts.numbers
            places = slice(bisect_left(numbers, before), bisect_left(numbers, before + len(times)))
            return {each - before: self._lost_at.get(each, 0) for each in numbers[places]}
        header = self._stream.header
        steps = np.diff(times, prepend=times[0] if last_s is None else last_s)
        # With even times, a small step back does not end a run.
        is_back = steps < (-STEP_BACK_S if self._is_even else 0)
        places_of_cuts = np.flatnonzero((steps > longest_step_s(header)) | is_back)
        lost = np.rint(np.minimum(steps[places_of_cuts] * header.rate, MOST_LOST)) - 1
        return dict(
            zip(places_of_cuts.tolist(), np.maximum(lost, 0).astype(int).tolist(), strict=True)
        )


def _part(samples: Samples, begin: int, end: int) -> Samples:
    part = slice(begin, end)
    return Samples(samples.times[part], samples.stamps[part], samples.values[part])


@dataclass(frozen=True, slots=True)
class Stretch:
    """The contents of one file: a run, or several with empty rows for the gaps between them."""

    first: int  # Number of its first run.
    runs: tuple[Run, ...]
    empty: tuple[int, ...]  # Number of empty rows before each run; 0 before the first.
    rate_hz: float

    @property
    def begin_s(self) -> float:
        """Time of the first row."""
        return self.runs[0].begin_s

    @property
    def rows(self) -> int:
        """Number of rows, including empty ones."""
        return sum(self.empty) + sum(each.count for each in self.runs)

    @property
    def gaps(self) -> Iterator[tuple[int, int]]:
        """First row and number of rows of each gap."""
        for (begin, _), rows in zip(self.begins, self.empty, strict=True):
            if rows:
                yield begin - rows, rows

    @property
    def begins(self) -> Iterator[tuple[int, Run]]:
        """First row of each run."""
        row = 0
        for run, empty in zip(self.runs, self.empty, strict=True):
            row += empty
            yield row, run
            row += run.count

    @property
    def away_s(self) -> float:
        """Largest time difference between a sample and its row, because a file has one rate."""
        ends = ((row, run.begin_s) for row, run in self.begins)
        lasts = ((row + run.count - 1, run.begin_s + run.length_s) for row, run in self.begins)
        told = [*ends, *lasts]
        return max(abs(self.begin_s + row / self.rate_hz - time_s) for row, time_s in told)


def stretches(runs: Sequence[Run], nominal_hz: float, longest_gap_s: float) -> list[Stretch]:
    """Divide runs into files.

    Parameters
    ----------
    longest_gap_s
        A longer gap starts a new file; 0 for one file per run.
    """
    joined: list[list[Run]] = []
    for run in runs:
        gap_s = run.begin_s - joined[-1][-1].end_s if joined else 0.0
        if joined and 0 < gap_s <= longest_gap_s:
            joined[-1].append(run)
        else:
            joined.append([run])
    first, found = 0, list[Stretch]()
    for some in joined:
        rate_hz = _common_rate(some, nominal_hz)
        found.append(Stretch(first, tuple(some), _rows_before(some, rate_hz), rate_hz))
        first += len(some)
    return found


def _common_rate(runs: Sequence[Run], nominal_hz: float) -> float:
    rates = [each.rate_hz(nominal_hz) for each in runs]
    steps = sum(each.count - 1 for each in runs)
    length_s = sum(each.length_s for each in runs)
    if len(set(rates)) == 1 or not steps or length_s <= 0:
        return rates[0]
    return steps / length_s


def _rows_before(runs: Sequence[Run], rate_hz: float) -> tuple[int, ...]:
    found: list[int] = []
    row = 0
    for run in runs:
        wanted = round((run.begin_s - runs[0].begin_s) * rate_hz)
        found.append(max(0, wanted - row))
        row += found[-1] + run.count
    return tuple(found)


def gap_text(lost: Sequence[int]) -> str:
    """Return the number of gaps and of missing samples in words."""
    gaps = "1 gap" if len(lost) == 1 else f"{len(lost)} gaps"
    samples = "1 sample" if sum(lost) == 1 else f"{sum(lost)} samples"
    return f"{gaps}, about {samples} missing"
