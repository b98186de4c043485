"""Finds the runs of a regular stream: samples between which nothing is missing."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.batches import batches
from biosensor_gateway.recording.xdf.measuring import cuts_of, longest_step_s

MOST_RUNS = 999
"""A stream that has more is not cut by gaps; its stamps make no sense."""


@dataclass(slots=True)
class Run:
    """Samples between which nothing is missing.

    Attributes
    ----------
    count
        How many; at least one.
    begin_s, end_s
        Times of the first and the last on the recorder's clock.
    least, greatest : ndarray of float64, shape (n_channels,)
        Of the finite values; infinite where there are none.
    period_s
        Between two samples, where that is not to be taken from their times; else 0.
    """

    count: int
    begin_s: float
    end_s: float
    least: NDArray[np.float64]
    greatest: NDArray[np.float64]
    period_s: float = 0.0

    def rate_hz(self, nominal_hz: float) -> float:
        """Return the nominal rate if it fits the times to half a sample, else the measured one."""
        length_s = self.end_s - self.begin_s
        steps = self.count - 1
        if self.period_s:
            length_s = steps * self.period_s
        if not steps or length_s <= 0 or abs(length_s * nominal_hz - steps) < 0.5:
            return nominal_hz
        return steps / length_s


class Runs:
    """The runs of one regular stream of numbers.

    In our own streams, and in others whose header says that samples may be missing, a run ends
    where the next stamp is later than it may be, or earlier than the last one. Elsewhere it ends
    where the line through the stamps jumps (`recording.xdf.pace`).
    """

    def __init__(self, chosen: Chosen, stream: Stream) -> None:
        self._chosen, self._stream = chosen, stream
        self._cuts = cuts_of((each.times for each in batches(chosen, stream)), stream.header)

    def pieces(self) -> Iterator[tuple[int, Samples]]:
        """Give the samples, each piece with the number of its run."""
        run = count = 0
        last_s: float | None = None
        for samples in batches(self._chosen, self._stream):
            cuts = self._in_batch(samples.times, last_s, count)
            last_s, count = float(samples.times[-1]), count + len(samples)
            for begin, end in pairwise([0, *cuts, len(samples)]):
                # Nothing is before a cut at the first sample of a batch.
                if begin == end:
                    continue
                if begin in cuts:
                    run += 1
                yield run, _part(samples, begin, end)

    def found(self) -> list[Run]:
        """Return all runs; at most one more than `MOST_RUNS`."""
        found: list[Run] = []
        period_s = self._cuts.period_s if self._cuts else 0.0
        for number, samples in self.pieces():
            values = np.asarray(samples.values, np.float64)
            is_finite = np.isfinite(values)
            least = np.where(is_finite, values, np.inf).min(axis=0)
            greatest = np.where(is_finite, values, -np.inf).max(axis=0)
            begin_s, end_s = float(samples.times[0]), float(samples.times[-1])
            if number == len(found):
                if number > MOST_RUNS:
                    break
                found.append(Run(len(samples), begin_s, end_s, least, greatest, period_s))
                continue
            run = found[-1]
            run.count += len(samples)
            run.end_s = end_s
            run.least = np.minimum(run.least, least)
            run.greatest = np.maximum(run.greatest, greatest)
        return found

    def _in_batch(self, times: NDArray[np.float64], last_s: float | None, before: int) -> list[int]:
        """Return at which samples of a batch runs begin; `before` is how many came before it."""
        if self._cuts is not None:
            numbers = self._cuts.numbers
            places = slice(bisect_left(numbers, before), bisect_left(numbers, before + len(times)))
            return [each - before for each in numbers[places]]
        steps = np.diff(times, prepend=times[0] if last_s is None else last_s)
        is_cut = (steps > longest_step_s(self._stream.header)) | (steps < 0)
        return np.flatnonzero(is_cut).tolist()


def _part(samples: Samples, begin: int, end: int) -> Samples:
    part = slice(begin, end)
    return Samples(samples.times[part], samples.stamps[part], samples.values[part])
