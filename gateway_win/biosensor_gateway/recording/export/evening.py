"""Puts the samples of a regular stream on the straight line of their run, as loaders do.

Other programs often stamp many samples at once, or when they came. Between two holes the times are
those of one line through all stamps, by least squares; holes stay as long as they were.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.xdf.pace import Cuts


@dataclass(slots=True)
class _Line:
    """Number against time of the samples of a run, as sums around their means."""

    begin: int
    count: int = 0
    mean_number: float = 0.0
    mean_s: float = 0.0
    spread: float = 0.0
    product: float = 0.0

    def add(self, times: NDArray[np.float64]) -> None:
        """Take in the samples that follow; means and sums are joined as Chan et al. (1983) do."""
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

    def times(self, first: int, count: int, usual_s: float) -> NDArray[np.float64]:
        """Return the times of samples by their numbers in the stream."""
        slope_s = self.product / self.spread if self.spread else usual_s
        # Of a few samples that came at once no line can be seen.
        if not 0.5 < slope_s / usual_s < 2:
            slope_s = usual_s
        number = np.arange(first - self.begin, first - self.begin + count, dtype=np.float64)
        return self.mean_s + slope_s * (number - self.mean_number)


class Evened:
    """The lines of the runs of one stream.

    Parameters
    ----------
    blocks
        Times of all its samples, finite, in s, in the order of the file.
    cuts
        Where runs begin.
    """

    def __init__(self, blocks: Iterable[NDArray[np.float64]], cuts: Cuts) -> None:
        self._begins = [0, *cuts.numbers]
        self._period_s = cuts.period_s
        self._lines = [_Line(begin) for begin in self._begins]
        done = 0
        for times in blocks:
            for run, first, last in self._parts(done, len(times)):
                self._lines[run].add(times[first - done : last - done])
            done += len(times)

    def applied(self, batches: Iterable[Samples]) -> Iterator[Samples]:
        """Give the samples with the times of the lines; all of the stream, in their order."""
        done = 0
        for samples in batches:
            times = np.concatenate(
                [
                    self._lines[run].times(first, last - first, self._period_s)
                    for run, first, last in self._parts(done, len(samples))
                ]
            )
            done += len(samples)
            yield replace(samples, times=times)

    def _parts(self, done: int, count: int) -> Iterator[tuple[int, int, int]]:
        """Divide samples by runs: number of the run, first sample, and the one behind the last."""
        first = done
        while first < done + count:
            run = bisect_right(self._begins, first) - 1
            end = self._begins[run + 1] if run + 1 < len(self._begins) else done + count
            last = min(end, done + count)
            yield run, first, last
            first = last
