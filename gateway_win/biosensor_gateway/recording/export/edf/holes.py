"""Finds where a channel has no value, which EDF can say only by an annotation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.edf.annotations import Annotation

_MOST_TOLD = 1000


class Holes:
    """Takes the samples of a stream in, and tells where values are missing.

    Attributes
    ----------
    found
        For each run what to annotate.
    """

    def __init__(self, stream: Stream, runs: int) -> None:
        self._stream = stream
        self.found: list[list[Annotation]] = [[] for _ in range(runs)]
        self._begins = [0.0] * runs
        # When the hole of a channel began; NaN outside of one.
        self._open = np.full(stream.header.channel_count, np.nan)
        self._number = -1
        self._last_s = 0.0
        self._untold = self._missing = 0

    def take(self, number: int, samples: Samples) -> None:
        """Take in some more samples of a run."""
        if number != self._number:
            self._close_all()
            self._number, self._begins[number] = number, float(samples.times[0])
        values = np.asarray(samples.values)
        if values.dtype.kind != "f":
            return
        is_missing = ~np.isfinite(values)
        self._missing += int(np.count_nonzero(is_missing))
        was_missing = np.vstack((~np.isnan(self._open), is_missing[:-1]))
        for row, place in np.argwhere(is_missing != was_missing):
            time_s = float(samples.times[row])
            if is_missing[row, place]:
                self._open[place] = time_s
            else:
                self._close(int(place), time_s)
        self._last_s = float(samples.times[-1])

    def notes(self) -> Iterator[str]:
        """Say how much is missing, once all is taken in."""
        self._close_all()
        name = self._stream.header.name
        if self._missing:
            yield f"{name}: {self._missing} values are none; annotations say where"
        if self._untold:
            yield f"{name}: {self._untold} more of these places have no annotation"

    def _close_all(self) -> None:
        for place in np.flatnonzero(~np.isnan(self._open)):
            self._close(int(place), self._last_s)

    def _close(self, place: int, end_s: float) -> None:
        begin_s = float(self._open[place])
        self._open[place] = np.nan
        told = self.found[self._number]
        if len(told) >= _MOST_TOLD:
            self._untold += 1
            return
        label = self._stream.header.labels[place]
        begin_s -= self._begins[self._number]
        length_s = max(0.0, end_s - self._begins[self._number] - begin_s)
        told.append(Annotation(begin_s, length_s, f"no value: {label}"))
