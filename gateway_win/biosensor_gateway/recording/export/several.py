"""Exports several recordings, or folders of them, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.recording.export.bids.study import Study
from biosensor_gateway.recording.export.exporting import Task, Watch, export
from biosensor_gateway.recording.export.outcome import Outcome
from biosensor_gateway.recording.xdf.container import RecordingError

Watching = Callable[[Path], AbstractContextManager[Watch]]
"""Takes a recording; while it is entered, its export is told to the watch."""


@dataclass(frozen=True, slots=True)
class Exported:
    """What became of one of several recordings.

    Attributes
    ----------
    outcome
        None if it was in the data set before, or failed.
    error
        Why nothing was written of it, as a sentence; empty if something was.
    """

    recording: Path
    outcome: Outcome | None = None
    error: str = ""

    @property
    def is_certain(self) -> bool:
        """Whether all of it is written, now or before, under names that are no guess."""
        return not self.error and (self.outcome is None or self.outcome.is_certain)


def export_several(
    recordings: Sequence[Path], task: Task, watching: Watching
) -> Iterator[Exported]:
    """Export one after the other; what is wrong with one keeps no other from being written.

    To ``bids`` and an output of its own they become one data set, see :mod:`.bids.study`. Who
    takes no more of what is given ends it between two recordings.

    Raises
    ------
    ConfigError
        If other formats are to be in the same data set, or its folder is something else.
    """
    study = None
    if task.output is not None and "bids" in task.formats:
        if len(task.formats) > 1:
            message = "a data set holds bids alone; export to other formats by a command of its own"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
        study = Study(task.output)
    for recording in recordings:

        def export_to(place: Path | None, recording: Path = recording) -> Outcome:
            with watching(recording) as watch:
                return export(recording, replace(task, output=place), watch)

        try:
            outcome = export_to(task.output) if study is None else study.add(recording, export_to)
        except (RecordingError, ConfigError) as error:
            yield Exported(recording, error=str(error))
        else:
            yield Exported(recording, outcome)


def recordings_in(places: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Return the recordings that are named or in folders that are named, and those left out.

    Left out of a folder is a recording that was salvaged: the salvaged one is taken.

    Raises
    ------
    ConfigError
        ``NOT_FOUND``, if a folder holds none.
    """
    found: list[Path] = []
    left_out: list[Path] = []
    for place in places:
        if not place.is_dir():
            found.append(place)
            continue
        inside = sorted(each for each in place.rglob("*") if is_recording(each))
        if not inside:
            raise ConfigError(ConfigReason.NOT_FOUND, f"there is no recording (.xdf) in {place}")
        names = {*inside}
        for each in inside:
            (left_out if _salvaged(each) in names else found).append(each)
    return list(dict.fromkeys(found)), left_out


def is_recording(path: Path) -> bool:
    """Whether a file is called as a recording is."""
    name = path.name.lower()
    return name.endswith((".xdf", ".xdf.gz", ".xdfz")) and path.is_file()


def _salvaged(path: Path) -> Path:
    return path.with_name(f"{path.name.split('.xdf')[0]}_salvaged.xdf")
