"""Ends a recording, sees its file closed, and judges it."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

import psutil

from biosensor_gateway.recording.here.errors import RecorderError, RecorderReason
from biosensor_gateway.recording.here.keeper import END_S
from biosensor_gateway.recording.here.memory import Kept, RecorderFolder
from biosensor_gateway.recording.here.program import PROGRAM_NAME
from biosensor_gateway.recording.here.results import StoppedHere
from biosensor_gateway.recording.here.said import Said
from biosensor_gateway.recording.here.ways import RECORD_STREAMS
from biosensor_gateway.recording.labrecorder.recording_file import Glance, wait_until_closed
from biosensor_gateway.recording.labrecorder.results import By
from biosensor_gateway.recording.xdf.expectation import ExpectedStream
from biosensor_gateway.recording.xdf.verdict import check

_MARGIN_S = 10.0
_STILL_S = 0.5
"""The program has ended, so nothing is written any more."""
_CLOSING_S = 30.0


def end(folder: RecorderFolder) -> StoppedHere:
    """End a recording; see `Recording.stop`."""
    begun = time.monotonic()
    if folder.is_kept():
        _ask(folder)
    kept = folder.kept()
    if kept is None:
        message = "nothing is being recorded here; begin with: biosensor-gateway record start"
        raise RecorderError(RecorderReason.NOT_RECORDING, message)
    file = Path(kept.file)
    if not kept.ended:
        _wait_for_program(kept)
    seen = wait_until_closed(file, _STILL_S, _CLOSING_S)
    folder.forget()
    if seen is None or not seen.is_closed:
        said = Said(folder.what_was_said())
        raise RecorderError(RecorderReason.NOT_CLOSED, _not_closed(kept, seen, said))
    took_s = time.monotonic() - begun
    expected = [ExpectedStream(each, each) for each in kept.required]
    return StoppedHere(
        by=By.GATEWAY,
        verified=True,
        file=file,
        bytes=seen.bytes,
        streams=len(seen.streams),
        with_samples=len(seen.with_samples),
        took_s=took_s,
        verdict=check(file, expected, kept.without),
        warnings=tuple(_warnings(kept)),
    )


def _ask(folder: RecorderFolder) -> None:
    try:
        folder.ask_to_stop()
    except OSError as error:
        message = (
            f"the recording cannot be told to end: {folder.path} cannot be written "
            f"({error.strerror or error})"
        )
        raise RecorderError(RecorderReason.UNWRITABLE, message) from error
    limit_s = END_S + _MARGIN_S
    if not folder.wait_until_free(limit_s):
        message = f"the recording did not end within {limit_s:g} s; look at it with: record status"
        raise RecorderError(RecorderReason.NOT_CLOSED, message)


def _wait_for_program(kept: Kept) -> None:
    """Wait while the program closes its file, whose keeper was killed."""
    with contextlib.suppress(psutil.Error):
        program = psutil.Process(kept.program)
        # Some other may have its number by now.
        if program.name().startswith(PROGRAM_NAME) or RECORD_STREAMS in program.cmdline():
            program.wait(END_S)


def _not_closed(kept: Kept, seen: Glance | None, said: Said) -> str:
    if seen is None:
        return f"{kept.file} still grows, though nobody keeps it; record stop --file looks again"
    what = "is empty" if not seen.bytes else "was not closed: it breaks off, or its disk is full"
    why = f"{kept.problem}; " if kept.problem else ""
    return (
        f"{why}{kept.file} {what}. Look at it with: biosensor-gateway xdf check. The last that "
        f"{kept.recorder} said: {said.end}"
    )


def _warnings(kept: Kept) -> list[str]:
    if kept.problem:
        return [kept.problem]
    return [] if kept.ended else ["the recording's keeper was killed, so it had ended before"]
