"""Finds the runs of a regular stream: samples between which nothing is missing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.batches import batches
from biosensor_gateway.recording.xdf.measuring import longest_step_s

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
    """

    count: int
    begin_s: float
    end_s: float
    least: NDArray[np.float64]
    greatest: NDArray[np.float64]

    def rate_hz(self, nominal_hz: float) -> float:
        """Return the nominal rate if it fits the stamps to half a sample, else the measured one."""
        length_s = self.end_s - self.begin_s
        steps = self.count - 1
        if not steps or length_s <= 0 or abs(length_s * nominal_hz - steps) < 0.5:
            return nominal_hz
        return steps / length_s


def pieces(chosen: Chosen, stream: Stream) -> Iterator[tuple[int, Samples]]:
    """Give the samples of a regular stream of numbers, each piece with the number of its run.

    A run ends where the next stamp is later than it may be, or earlier than the last one.
    """
    longest_s = longest_step_s(stream.header)
    number, last_s = 0, None
    for samples in batches(chosen, stream):
        times = samples.times
        steps = np.diff(times, prepend=times[0] if last_s is None else last_s)
        cuts = np.flatnonzero((steps > longest_s) | (steps < 0))
        last_s = float(times[-1])
        for begin, end in zip([0, *cuts], [*cuts, len(times)], strict=True):
            # Nothing is before a cut at the first sample of a batch.
            if begin == end:
                continue
            if begin in cuts:
                number += 1
            yield number, _part(samples, int(begin), int(end))


def find_runs(chosen: Chosen, stream: Stream) -> list[Run]:
    """Return all runs of a regular stream of numbers; at most one more than `MOST_RUNS`."""
    found: list[Run] = []
    for number, samples in pieces(chosen, stream):
        values = np.asarray(samples.values, np.float64)
        is_finite = np.isfinite(values)
        least = np.where(is_finite, values, np.inf).min(axis=0)
        greatest = np.where(is_finite, values, -np.inf).max(axis=0)
        begin_s, end_s = float(samples.times[0]), float(samples.times[-1])
        if number == len(found):
            if number > MOST_RUNS:
                break
            found.append(Run(len(samples), begin_s, end_s, least, greatest))
            continue
        run = found[-1]
        run.count += len(samples)
        run.end_s = end_s
        run.least, run.greatest = np.minimum(run.least, least), np.maximum(run.greatest, greatest)
    return found


def _part(samples: Samples, begin: int, end: int) -> Samples:
    part = slice(begin, end)
    return Samples(samples.times[part], samples.stamps[part], samples.values[part])
