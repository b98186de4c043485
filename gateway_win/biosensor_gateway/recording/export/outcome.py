"""Tells what became of an export."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from biosensor_gateway.recording.export.exporter import Missing
from biosensor_gateway.recording.participants import Mismatch
from biosensor_gateway.recording.xdf.container import Damage


@dataclass(frozen=True, slots=True)
class Written:
    """One format of a recording, as it lies on the disk.

    Attributes
    ----------
    size
        In bytes, of all files.
    notes
        What the format could not take, a sentence each.
    """

    format: str
    path: Path
    size: int
    notes: tuple[str, ...]

    @property
    def is_whole(self) -> bool:
        """Whether all streams are in it that the format can hold."""
        return not any(isinstance(each, Missing) for each in self.notes)


@dataclass(frozen=True, slots=True)
class NothingForIt:
    """A format for which the recording has nothing.

    Attributes
    ----------
    why
        A sentence for the person.
    """

    format: str
    why: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a recording.

    Attributes
    ----------
    streams
        Name, source_id and number of samples in the file of what was chosen.
    damages
        What could not be read of the recording.
    clock_notes
        What is to be said of the times.
    without
        Formats that were asked for, and not written.
    mismatch
        The recording's name and its sensors name different participants, and nobody has said
        who is right; None otherwise.
    """

    path: Path
    streams: tuple[tuple[str, str, int], ...]
    written: tuple[Written, ...]
    damages: tuple[Damage, ...]
    clock_notes: tuple[str, ...]
    without: tuple[NothingForIt, ...] = ()
    mismatch: Mismatch | None = None

    @property
    def is_certain(self) -> bool:
        """Whether all of it was written, under names that are no guess."""
        return self.is_whole and self.mismatch is None

    @property
    def is_whole(self) -> bool:
        """Whether all of the recording was written in all formats, as far as these can hold it."""
        is_whole = all(each.is_whole for each in self.written)
        return is_whole and not self.damages and not self.without
