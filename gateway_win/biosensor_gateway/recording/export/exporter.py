"""The interface of a format: it writes what was chosen of a recording to one file or folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum, unique
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from biosensor_common.ros_clock import NS_PER_S
from biosensor_gateway.recording.contents.choice import Chosen

Progress = Callable[[float], None]
"""Takes how many seconds of the recording are done."""


@unique
class Clock(StrEnum):
    """On which clock times are written."""

    LSL = "lsl"
    """The recorder's LSL clock."""
    WALL = "wall"
    """Unix time; only of a recording whose `wall` is known."""


@unique
class Times(StrEnum):
    """Which times samples of a regular stream have, and what a gap does."""

    RECORDED = "recorded"
    """Those of the stamps; in a format that knows no gaps, one ends a file."""
    EVEN = "even"
    """Those of a straight line between two gaps; a gap is an event, and the file goes on."""


@dataclass(frozen=True, slots=True)
class Order:
    """How to write it.

    Attributes
    ----------
    clock
        Of the times.
    name
        What to call it: the recording's name without its suffix.
    task, session
        What was recorded, for formats that tell it; empty for what `name` says.
    participant
        Whose all of it is, whatever the recorded events say; empty for what these say.
    times
        Of regular streams.
    is_wide
        Whether tables are to hold all streams of a rate side by side, too.
    """

    clock: Clock
    name: str
    task: str = ""
    session: str = ""
    participant: str = ""
    times: Times = Times.RECORDED
    is_wide: bool = False


class Missing(str):
    """A sentence of a format about a whole stream that is not in it, though it could be."""

    __slots__ = ()


def with_reasons(sentence: str, notes: Sequence[str]) -> str:
    """Say also why streams were left out, where nothing else is left to say it."""
    return "; ".join([sentence, *notes])


class Exporter(Protocol):
    """A format."""

    @property
    def suffix(self) -> str:
        """What is appended to the recording's name: ``.csv`` of a file, ``_csv`` of a folder."""
        ...

    def write(
        self, chosen: Chosen, order: Order, target: Path, progress: Progress
    ) -> Sequence[str]:
        """Write what was chosen, chunk by chunk: a recording may exceed the memory.

        Parameters
        ----------
        chosen
            Streams and span of time.
        target
            File or folder to make; there is none yet. Its name is final, its folder is not.
        progress
            Is told now and then how far it is.

        Returns
        -------
        sequence of str
            Sentences for the person: what the format could not take; `Missing` of a whole stream.

        Raises
        ------
        RecordingError
            ``EMPTY``, if nothing that was chosen can be written in this format, or if the
            recording cannot be read any more.
        OSError
            If the target cannot be written.
        """
        ...


class SampleCount:
    """Tells the progress of whoever takes one stream after the other, by samples.

    Parameters
    ----------
    progress
        Is told at most once for each percent.
    """

    def __init__(self, chosen: Chosen, progress: Progress) -> None:
        begin_s = max(chosen.begin_s, chosen.contents.begin_s)
        self._length_s = max(0.0, min(chosen.end_s, chosen.contents.end_s) - begin_s)
        self._all = max(1, sum(each.sample_count for each in chosen.streams))
        self._progress = progress
        self._done = self._told = 0

    def add(self, samples: int) -> None:
        """Take note that so many more samples are written."""
        self._done += samples
        if self._done - self._told > self._all // 100:
            self._told = self._done
            self._progress(min(1.0, self._done / self._all) * self._length_s)


def on_clock(chosen: Chosen, clock: Clock, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return times of samples on the clock that is wanted, in s.

    Unix time of our days has steps of 0.24 us in this form; who needs ns asks the
    recording's `wall`.

    Parameters
    ----------
    times : ndarray of float64, shape (n_samples,)
        On the recorder's LSL clock.
    """
    wall = chosen.contents.wall
    if clock is Clock.LSL or wall is None:
        return times
    return wall.to_unix_ns(times) / NS_PER_S
