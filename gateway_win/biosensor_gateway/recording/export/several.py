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
"""Takes a recording; its context provides the callback for the progress of its export."""


@dataclass(frozen=True, slots=True)
class Exported:
    """The result for one of several recordings.

    Attributes
    ----------
    outcome
        None if it was in the dataset before, or failed.
    error
        Why nothing was written, as a sentence; empty on success.
    """

    recording: Path
    outcome: Outcome | None = None
    error: str = ""

    @property
    def is_certain(self) -> bool:
        """Whether all of it is written, now or before, with certain names."""
        return not self.error and (self.outcome is None or self.outcome.is_certain)


def export_several(
    recordings: Sequence[Path], task: Task, watching: Watching
) -> Iterator[Exported]:
    """Export recordings one by one; an error in one does not stop the others.

    With ``bids`` and an output folder they become one dataset, see :mod:`.bids.study`. This is a
    generator: it stops between two recordings if the caller stops iterating.

    Raises
    ------
    ConfigError
        If other formats would go into the same dataset, or its folder is something else.
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
    """Return the recordings in a list of files and folders, and those left out.

    If a recording was salvaged, its salvaged version is used and the original left out.

    Raises
    ------
    ConfigError
        ``NOT_FOUND``, if a folder contains none.
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
    """Whether a file has a recording's suffix."""
    name = path.name.lower()
    return name.endswith((".xdf", ".xdf.gz", ".xdfz")) and path.is_file()


def _salvaged(path: Path) -> Path:
    return path.with_name(f"{path.name.split('.xdf')[0]}_salvaged.xdf")
