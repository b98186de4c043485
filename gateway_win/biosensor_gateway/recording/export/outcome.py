"""Results of an export."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from biosensor_gateway.recording.export.exporter import Missing
from biosensor_gateway.recording.participants import Mismatch
from biosensor_gateway.recording.xdf.container import Damage


@dataclass(frozen=True, slots=True)
class Written:
    """One written format of a recording.

    Attributes
    ----------
    size
        Total size in bytes.
    notes
        Sentences about what the format could not contain.
    """

    format: str
    path: Path
    size: int
    notes: tuple[str, ...]

    @property
    def is_whole(self) -> bool:
        """Whether it contains all streams that fit the format."""
        return not any(isinstance(each, Missing) for each in self.notes)


@dataclass(frozen=True, slots=True)
class NothingForIt:
    """A format for which the recording has no suitable data.

    Attributes
    ----------
    why
        A sentence for the user.
    """

    format: str
    why: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of exporting a recording.

    Attributes
    ----------
    streams
        Name, source_id and number of samples of the selected streams.
    damages
        Unreadable parts of the recording.
    clock_notes
        Sentences about the times; `Missing` if samples have none.
    without
        Requested formats that were not written.
    mismatch
        Set if the recording's name and sensors have different participants and the user has not
        decided which is right.
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
        """Whether all of it was written, with certain names."""
        return self.is_whole and self.mismatch is None

    @property
    def is_whole(self) -> bool:
        """Whether every format contains everything that fits it."""
        is_whole = all(each.is_whole for each in self.written)
        is_timed = not any(isinstance(each, Missing) for each in self.clock_notes)
        return is_whole and is_timed and not self.damages and not self.without
