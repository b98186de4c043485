"""Writes one BDF+ file with a section of a regular stream and annotations of missing values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.contents.choice import BATCH, Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.edf.bdf import (
    Annotation,
    Channel,
    Facts,
    annotation_records,
    channel,
    digital,
    header,
    layout,
    records,
)
from biosensor_gateway.recording.export.exporter import Clock
from biosensor_gateway.recording.export.runs import BAD_GAP, Runs, Stretch
from biosensor_gateway.recording.export.tables import unique

INSTEAD = "the smallest value of the channel, below all measured ones, is written"
"""Describes what is written for missing values."""
_LABEL = 16
# The header has no room for more.
_MOST_CHANNELS = 4000
_MOST_TOLD = 1000


def length_s(stretch: Stretch) -> float:
    """Return the duration of a file, including padding."""
    plan = layout(stretch.rows, stretch.rate_hz)
    return plan.samples * plan.records / stretch.rate_hz


class Given:
    """Yields the values of runs; these must be requested in order."""

    def __init__(self, cut: Runs) -> None:
        self._pieces = cut.pieces()
        self._next = next(self._pieces, None)

    def _of(self, number: int) -> Iterator[NDArray[np.generic]]:
        while self._next is not None and self._next[0] <= number:
            found, samples = self._next
            if found == number:
                yield np.asarray(samples.values)
            self._next = next(self._pieces, None)

    def of_stretch(self, stretch: Stretch) -> Iterator[NDArray[np.generic]]:
        """Yield the values of its runs, with NaN in the rows between them."""
        for number, empty in enumerate(stretch.empty, stretch.first):
            for begin in range(0, empty, BATCH):
                yield np.full((min(BATCH, empty - begin), len(stretch.runs[0].least)), np.nan)
            yield from self._of(number)


def channels_of(stream: Stream, stretch: Stretch) -> tuple[list[Channel], list[str]]:
    """Return the channels to write, and the labels of those that cannot be written."""
    labels = stream.header.labels
    plain = ["".join(c if " " <= c <= "~" else "_" for c in each) for each in labels]
    short = [each[:_LABEL] for each in plain]
    if len(set(short)) < len(short):
        # Leaves room for a suffix that makes them unique.
        short = unique(each[: _LABEL - 5] for each in plain)
    lowest = np.min([each.least for each in stretch.runs], axis=0)
    highest = np.max([each.greatest for each in stretch.runs], axis=0)
    named = zip(short, stream.meaning.units, lowest, highest, strict=True)
    found = [
        channel(place, label, unit, float(least), float(greatest))
        for place, (label, unit, least, greatest) in enumerate(named)
    ]
    kept = [each for each in found if each is not None][:_MOST_CHANNELS]
    places = {each.place for each in kept}
    return kept, [label for place, label in enumerate(labels) if place not in places]


def write_stretch(
    chosen: Chosen,
    clock: Clock,
    stream: Stream,
    stretch: Stretch,
    channels: Sequence[Channel],
    happened: Sequence[Annotation],
    given: Given,
    path: Path,
) -> None:
    """Write a file.

    Parameters
    ----------
    happened
        Annotations besides those of its runs and gaps.
    given
        Source of its values, not yet read.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    plan = layout(stretch.rows, stretch.rate_hz)
    facts = _facts(chosen, clock, stream, stretch)
    told = sorted([*_of_file(stretch), *happened])
    texts, room = annotation_records(told, plan.records, plan.record_s, facts.start_s)
    with path.open("xb") as file:
        file.write(header(channels, plan, facts, room))
        steps = (digital(each, channels) for each in given.of_stretch(stretch))
        file.writelines(records(steps, plan.samples, texts, room))


def _facts(chosen: Chosen, clock: Clock, stream: Stream, stretch: Stretch) -> Facts:
    identity, wall = stream.header.identity, chosen.contents.wall
    begun_ns = None
    if clock is Clock.WALL and wall is not None:
        begun_ns = int(wall.to_unix_ns(np.array([stretch.begin_s]))[0])
    participant = identity.participant if identity else ""
    equipment = f"{identity.sensor}/{identity.unit}" if identity else stream.header.name
    return Facts(participant, equipment, begun_ns)


def _of_file(stretch: Stretch) -> Iterator[Annotation]:
    """Yield the annotations that describe a file's runs, gaps and padding."""
    rate_hz = stretch.rate_hz
    for row, run in stretch.begins:
        yield Annotation(row / rate_hz, 0.0, f"LSL time {run.begin_s:.6f} s")
    for row, rows in stretch.gaps:
        yield Annotation(row / rate_hz, rows / rate_hz, BAD_GAP)
    end_s = stretch.rows / rate_hz
    if (rest_s := length_s(stretch) - end_s) > 0.5 / rate_hz:
        yield Annotation(end_s, rest_s, "end of data, followed by padding")


class Holes:
    """Finds missing values in the samples of a stream.

    Parameters
    ----------
    begins
        Start time of the file of each run.

    Attributes
    ----------
    found
        Annotations of each run.
    """

    def __init__(self, stream: Stream, begins: Sequence[float]) -> None:
        self._stream, self._begins = stream, begins
        self.found: list[list[Annotation]] = [[] for _ in begins]
        # Start of the current gap of each channel; NaN outside of a gap.
        self._open = np.full(stream.header.channel_count, np.nan)
        self._number = -1
        self._last_s = 0.0
        self._untold = self._missing = 0

    def take(self, number: int, samples: Samples) -> None:
        """Process the next samples of a run."""
        if number != self._number:
            self._close_all()
            self._number = number
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
        """Yield sentences about missing values, after all samples were processed."""
        self._close_all()
        name = self._stream.header.name
        if self._missing:
            yield f"{name}: {self._missing} values are missing; annotations mark the places"
        if self._untold:
            yield f"{name}: {self._untold} more places are not annotated"

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
