"""Chooses the file to record to, and takes its name."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.recording.here.errors import RecorderError, RecorderReason
from biosensor_gateway.recording.labrecorder.file_name import (
    MAX_RUN,
    SUFFIXES,
    Place,
    choose_target,
)


def candidates(place: Place, *, is_run_given: bool) -> tuple[Path, ...]:
    """Return the files that will do, the first best.

    A BIDS name has its run and all after it, unless its run was asked for. In a folder without
    a name, the time is the name.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, if `place` says too little or contradicts itself.
    """
    return tuple(_candidates(place, is_run_given=is_run_given))


def take_file(files: Sequence[Path]) -> Path:
    """Make the first file whose name is free, empty, so that nobody else takes it.

    Raises
    ------
    RecorderError
        ``EXISTS`` or ``UNWRITABLE``.
    """
    for file in files:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.open("xb").close()
        except FileExistsError:
            # Else a folder cannot be made, because a file has its name.
            if file.parent.is_dir():
                continue
            message = f"{file.parent} is no folder; choose another one"
            raise RecorderError(RecorderReason.UNWRITABLE, message) from None
        except OSError as error:
            message = f"{file} cannot be written ({error.strerror or error}); choose another folder"
            raise RecorderError(RecorderReason.UNWRITABLE, message) from error
        return file
    message = f"{files[0]} is there already; choose another name or run"
    raise RecorderError(RecorderReason.EXISTS, message)


def _candidates(place: Place, *, is_run_given: bool) -> Iterator[Path]:
    if place.recorder_folder:
        message = "--recorder-folder is for a LabRecorder on another computer; leave it out"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    target = choose_target(place, is_local=True)
    if target.folder is None:
        raise AssertionError("a place on this computer has a folder")
    if place.file is not None:
        # As it was written: only LabRecorder's window makes it lower-case.
        yield _speakable(target.files[-1])
    elif place.labels is None:
        yield target.folder / time.strftime("recording-%Y%m%d-%H%M%S.xdf")
    else:
        last = place.labels.run if is_run_given else MAX_RUN
        for run in range(place.labels.run, last + 1):
            yield target.folder / replace(place.labels, run=run).path


def _speakable(file: Path) -> Path:
    if file.suffix.lower() != SUFFIXES[0]:
        message = f"--file {file}: the name must end in .xdf"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    # It is run in the file's folder, so that only the name must be of such letters.
    if sys.platform == "win32" and not file.name.isascii():
        message = (
            f"--file {file.name}: on Windows LabRecorder's program takes names of English letters "
            "only; the folder may have any"
        )
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    return file
