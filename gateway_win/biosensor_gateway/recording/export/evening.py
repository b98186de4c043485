"""Puts the samples of a regular stream on the straight line of their run, as loaders do.

Other programs often stamp many samples at once, or when they came. Between two holes the times are
those of one line through all stamps, by least squares; holes stay as long as they were.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.export.fitted_line import FittedLine
from biosensor_gateway.recording.xdf.pace import Cuts


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
        self._lines = [FittedLine() for _ in self._begins]
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
                    self._times(run, first, last)
                    for run, first, last in self._parts(done, len(samples))
                ]
            )
            done += len(samples)
            yield replace(samples, times=times)

    def _times(self, run: int, first: int, last: int) -> NDArray[np.float64]:
        """Return the times of samples of a run, the last one excluded."""
        line = self._lines[run]
        slope_s = line.product / line.spread if line.spread else self._period_s
        # Of a few samples that came at once no line can be seen.
        if not 0.5 < slope_s / self._period_s < 2:
            slope_s = self._period_s
        number = np.arange(first - self._begins[run], last - self._begins[run], dtype=np.float64)
        return line.mean_s + slope_s * (number - line.mean_number)

    def _parts(self, done: int, count: int) -> Iterator[tuple[int, int, int]]:
        """Divide samples by runs: number of the run, first sample, and the one behind the last."""
        first = done
        while first < done + count:
            run = bisect_right(self._begins, first) - 1
            end = self._begins[run + 1] if run + 1 < len(self._begins) else done + count
            last = min(end, done + count)
            yield run, first, last
            first = last
