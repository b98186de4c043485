"""The interface of a format, which writes a selection to one file or folder, and its times."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from enum import StrEnum, unique
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from biosensor_common.ros_clock import NS_PER_S
from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.wall_clock import WallClock

Progress = Callable[[float], None]
"""Called with the seconds of the recording that are done."""


_HERE = "biosensor_gateway.recording.export"
NEED_RATES = frozenset({"bids", "edf", "kubios"})
"""Formats in which a stream needs a rate; see `recording.contents.contents`."""
HAVE_WIDE = frozenset({"csv", "csv.gz"})
"""Formats with a table for each rate, if it is asked for."""
USUAL_GROWTH = 2.0
"""The multiple for formats that are not listed."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@unique
class Clock(StrEnum):
    """Clock of the exported times."""

    LSL = "lsl"
    """The recorder's LSL clock."""
    WALL = "wall"
    """Unix time; only for a recording whose `wall` is known."""


@unique
class Times(StrEnum):
    """The times of samples in regular streams, and how gaps are handled."""

    RECORDED = "recorded"
    """The recorded timestamps; in a format without gaps, a gap ends the file."""
    EVEN = "even"
    """Evenly spaced times between two gaps; a gap becomes an event and the file continues."""


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of an export."""

    clock: Clock
    name: str  # Base name of the output: the recording's name without its suffix.
    # task, session: task and session, for formats that contain them; empty to take them from
    # `name`.
    task: str = ""
    session: str = ""
    # Participant of all data, overriding the recorded ones; empty to keep these.
    participant: str = ""
    times: Times = Times.RECORDED
    # Whether to write additional tables with all streams of a rate side by side.
    is_wide: bool = False
    notes: Sequence[str] = ()  # Sentences about its streams that hold for any format.


class Missing(str):
    """A note that a whole stream is missing, although the format could contain it."""

    __slots__ = ()


def with_reasons(sentence: str, notes: Sequence[str]) -> str:
    """Append the notes about left-out streams to an error message."""
    return "; ".join([sentence, *notes])


class Exporter(Protocol):
    """A format."""

    @property
    def suffix(self) -> str:
        """Suffix of the output's name: ``.csv`` for a file, ``_csv`` for a folder."""
        ...

    def write(
        self, chosen: Chosen, options: ExportOptions, target: Path, progress: Progress
    ) -> Sequence[str]:
        """Write the selection chunk by chunk, because a recording may exceed the memory.

        Parameters
        ----------
        target
            File or folder to create; it does not exist. Its name is final, its location is
            temporary.

        Returns
        -------
        sequence of str
            Notes for the user about what the format could not contain; `Missing` for whole
            streams.

        Raises
        ------
        RecordingError
            ``EMPTY``, if nothing in the selection fits this format, or if the recording cannot be
            read any more.
        OSError
            If the target cannot be written.
        """
        ...


class SampleCount:
    """Reports progress by samples, for formats that write one stream after the other.

    Parameters
    ----------
    progress
        Called at most once per percent.
    """

    def __init__(self, chosen: Chosen, progress: Progress) -> None:
        begin_s = max(chosen.begin_s, chosen.contents.begin_s)
        self._length_s = max(0.0, min(chosen.end_s, chosen.contents.end_s) - begin_s)
        self._all = max(1, sum(each.sample_count for each in chosen.streams))
        self._progress = progress
        self._done = self._told = 0

    def add(self, samples: int) -> None:
        """Add a number of written samples."""
        self._done += samples
        if self._done - self._told > self._all // 100:
            self._told = self._done
            self._progress(min(1.0, self._done / self._all) * self._length_s)


def on_clock(chosen: Chosen, clock: Clock, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert times of samples to another clock, in s.

    Current Unix times have a resolution of 0.24 us in float64; for ns, use the recording's `wall`.

    Parameters
    ----------
    times : ndarray of float64, shape (n_samples,)
        On the recorder's LSL clock.
    """
    wall = chosen.contents.wall
    if clock is Clock.LSL or wall is None:
        return times
    return wall.to_unix_ns(times) / NS_PER_S


def _load(module: str, attribute: str, **options: bool) -> Exporter:
    # Imported on demand, because some import large libraries.
    return getattr(import_module(f"{_HERE}.{module}"), attribute)(**options)


FORMATS: Mapping[str, Callable[[], Exporter]] = {
    "bids": partial(_load, "bids.dataset", "BidsDataset"),
    "csv": partial(_load, "csv.wide", "WideCsv"),
    "csv.gz": partial(_load, "csv.wide", "WideCsv", is_packed=True),
    "csv-long": partial(_load, "csv.long", "LongCsv"),
    "csv-long.gz": partial(_load, "csv.long", "LongCsv", is_packed=True),
    "edf": partial(_load, "edf.edf_exporter", "Edf"),
    "kubios": partial(_load, "kubios", "Kubios"),
    "ledalab": partial(_load, "ledalab", "Ledalab"),
    "mcap": partial(_load, "mcap.mcap_exporter", "McapExporter"),
}
"""Functions that create the exporter of each format."""

GROWTH: Mapping[str, float] = {
    "csv": 3.0,
    "csv.gz": 1.5,
    "csv-long": 20.0,
    "csv-long.gz": 3.0,
    "mcap": 8.0,
    "bids": 3.0,
}
"""Size of a format on the disk, as a multiple of the samples in the recording."""


@dataclass(frozen=True, slots=True)
class Timeline:
    """Seconds since the first sample of a selection, on one of the clocks."""

    zero_s: float  # The zero on the recorder's LSL clock.
    zero_unix_ns: int | None  # Its Unix time; None if unknown.
    _wall: WallClock | None

    @property
    def begin_s(self) -> float:
        """The zero as LSL time or Unix time, depending on the clock."""
        return self.zero_s if self._wall is None else (self.zero_unix_ns or 0) / NS_PER_S

    def since_zero(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return seconds since zero.

        Parameters
        ----------
        times : ndarray of float64, shape (n_samples,)
            On the recorder's LSL clock.
        """
        if self._wall is None or self.zero_unix_ns is None:
            return times - self.zero_s
        return (self._wall.to_unix_ns(times) - self.zero_unix_ns) / NS_PER_S

    def described(self) -> dict[str, object]:
        """Return a description of the times for a sidecar."""
        clock = "unix time" if self._wall else "the recorder's LSL clock"
        said: dict[str, object] = {
            "Description": f"first sample of the recording; seconds since it are on {clock}",
            "LslTime": self.zero_s,
        }
        if self.zero_unix_ns is not None:
            date = _EPOCH + timedelta(microseconds=self.zero_unix_ns // 1000)
            said["Date"] = date.isoformat(timespec="microseconds")
        return {"TimeZero": said}


def timeline(chosen: Chosen, clock: Clock) -> Timeline:
    """Return the timeline of a selection."""
    zero_s = max(chosen.begin_s, chosen.contents.begin_s)
    wall = chosen.contents.wall
    unix_ns = None if wall is None else int(wall.to_unix_ns(np.array([zero_s]))[0])
    return Timeline(zero_s, unix_ns, wall if clock is Clock.WALL else None)
