"""Checks, salvages and exports recordings on the disk, and opens their folders."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import sys
from collections.abc import Generator
from itertools import islice
from pathlib import Path
from typing import Annotated

import structlog
from fastapi import APIRouter
from pydantic import BaseModel, Field

from biosensor_common.errors import ConfigError, ConfigReason, GatewayError
from biosensor_gateway.page.advice import clicked
from biosensor_gateway.page.models import ExplainedFinding, Outcome, PathText, all_explained
from biosensor_gateway.page.routes.replay import RecordingPath, whole_path
from biosensor_gateway.page.session import Session
from biosensor_gateway.recording.contents.choice import Selection, choose
from biosensor_gateway.recording.contents.contents import open_contents
from biosensor_gateway.recording.export.exporter import FORMATS, Progress
from biosensor_gateway.recording.export.job import (
    Exported,
    Task,
    Watch,
    export_several,
    recordings_in,
)
from biosensor_gateway.recording.export.marker_events import markers
from biosensor_gateway.recording.export.outcome import sentences
from biosensor_gateway.recording.participants import Whose
from biosensor_gateway.recording.recorder.state import is_going_on, require_ended
from biosensor_gateway.recording.xdf import verdict as judging
from biosensor_gateway.recording.xdf.event_rules import tells_devices
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.salvage import outcome as salvage_outcome
from biosensor_gateway.recording.xdf.salvage.outcome import salvage, salvaged_path
from biosensor_gateway.recording.xdf.verdict import by_devices, judge

MOST_MARKERS = 1000
_log = structlog.get_logger("biosensor_gateway.page")


class RecordedMarker(BaseModel):
    """A marker of a recording, with its seconds since the recording started."""

    time_s: float
    text: str


class Judged(BaseModel):
    """Whether a recording can be trusted.

    Attributes
    ----------
    markers
        The first `MOST_MARKERS`.
    marker_count
        Number of all markers.
    unread
        Why the markers cannot be read; empty if they can.
    """

    colour: str
    sentence: str
    findings: list[ExplainedFinding]
    can_be_salvaged: bool
    markers: list[RecordedMarker] = Field(default_factory=list[RecordedMarker])
    marker_count: int = 0
    unread: str = ""


class Salvaged(BaseModel):
    """Outcome of salvaging a recording, in sentences; `written` is empty if it was undamaged."""

    written: str
    said: list[str]


class ToSalvage(RecordingPath):
    """A recording to salvage.

    Attributes
    ----------
    header_from
        Another recording of the same streams, in place of headers that are lost; may be empty.
    """

    header_from: PathText = ""


class NewExport(RecordingPath):
    """A recording to export, or a folder of recordings; without `output`, next to them.

    Attributes
    ----------
    whose
        Which participant is right, that of the file name or of the sensors; None if undecided.
    """

    formats: Annotated[list[str], Field(min_length=1, max_length=len(FORMATS))]
    output: PathText = ""
    whose: Annotated[Whose | None, Field(strict=False)] = None


class ExportedView(BaseModel):
    """Outcome of one recording's export.

    Attributes
    ----------
    is_written
        Whether anything of it is written, now or before.
    is_certain
        Whether all of it is written, with certain names.
    """

    recording: str
    is_written: bool
    is_certain: bool
    said: list[str]


class ExportView(BaseModel):
    """Progress of an export.

    Attributes
    ----------
    recording, format
        What is being written.
    part
        Progress of that, from 0 to 1.
    count, done
        Number of recordings, and those that are finished.
    said
        Sentences about the export as a whole.
    problem
        Why it ended early; empty if it did not.
    """

    is_running: bool = False
    recording: str = ""
    format: str = ""
    part: float = 0.0
    count: int = 0
    done: list[ExportedView] = Field(default_factory=list[ExportedView])
    said: list[str] = Field(default_factory=list[str])
    problem: str = ""


class Exports:
    """One export at a time, in a thread; it can be ended between two recordings."""

    def __init__(self) -> None:
        self.view = ExportView()
        self._task: asyncio.Task[None] | None = None
        self._is_unwanted = False

    def start(self, wanted: NewExport) -> None:
        """Begin to export.

        Raises
        ------
        ConfigError
            ``IN_USE`` while an export is running; ``WRONG_VALUE`` for an unknown format or a
            relative path; ``NOT_FOUND`` if there is no recording.
        """
        if self.view.is_running:
            raise ConfigError(ConfigReason.IN_USE, "an export is running; wait until it ends")
        for each in wanted.formats:
            if each not in FORMATS:
                message = f"there is no format {each!r}; choose from {', '.join(FORMATS)}"
                raise ConfigError(ConfigReason.WRONG_VALUE, message)
        output = whole_path(wanted.output) if wanted.output else None
        recordings, left_out = recordings_in([whole_path(wanted.path)])
        if output is not None and "bids" not in wanted.formats and not output.is_dir():
            message = f"there is no folder {output}; create it first"
            raise ConfigError(ConfigReason.NOT_FOUND, message)
        said = [f"{each} is left out, because it was salvaged next to it" for each in left_out]
        self._is_unwanted = False
        self.view = ExportView(is_running=True, count=len(recordings), said=said)
        task = Task(wanted.formats, Selection(), output=output, whose=wanted.whose)
        self._task = asyncio.create_task(self._run(recordings, task))
        self._task.add_done_callback(self._note_end)

    def end(self) -> None:
        """End after the recording that is being written."""
        self._is_unwanted = True

    async def _run(self, recordings: list[Path], task: Task) -> None:
        try:
            await asyncio.to_thread(self._export, recordings, task)
        except (GatewayError, OSError) as error:
            self.view.problem = clicked(str(error))

    def _note_end(self, task: asyncio.Task[None]) -> None:
        """Report an unexpected failure, so that the export does not look complete."""
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("an export has failed", exc_info=error)
            self.view.problem = (
                f"the export of {self.view.recording or 'the recordings'} failed unexpectedly "
                f"({error!r}); try it with biosensor-gateway xdf export"
            )
        self.view.is_running = False

    def _export(self, recordings: list[Path], task: Task) -> None:
        for each in export_several(recordings, task, self._watching):
            self.view.done.append(_exported(each))
            if self._is_unwanted and len(self.view.done) < len(recordings):
                left = len(recordings) - len(self.view.done)
                self.view.problem = f"ended early: {left} recordings are not written"
                return

    @contextlib.contextmanager
    def _watching(self, recording: Path) -> Generator[Watch]:
        def watch(name: str, seconds: float) -> Progress:
            self.view.recording, self.view.format, self.view.part = recording.name, name, 0.0

            def progress(done_s: float) -> None:
                self.view.part = min(1.0, done_s / seconds) if seconds > 0 else 1.0

            return progress

        yield watch


def add_files(router: APIRouter, session: Session) -> None:
    """Add the routes of recordings on the disk."""
    exports = Exports()

    @router.post("/recordings/check")
    async def check(recording: RecordingPath) -> Judged:
        """Check whether a recording can be trusted, and list its markers."""
        return await asyncio.to_thread(_judged, whole_path(recording.path), session)

    @router.post("/recordings/salvage")
    async def salvage_it(wanted: ToSalvage) -> Salvaged:
        """Write the readable part of a damaged recording to a file next to it."""
        other = whole_path(wanted.header_from) if wanted.header_from else None
        return await asyncio.to_thread(_salvaged, whole_path(wanted.path), other)

    @router.post("/recordings/open-folder")
    async def show(recording: RecordingPath) -> Outcome:
        """Open the folder of a recording in the file manager of this computer."""
        path = whole_path(recording.path)
        folder = path if path.is_dir() else path.parent
        await asyncio.to_thread(open_folder, folder)
        return Outcome(sentence=f"{folder} is open in the file manager.")

    @router.get("/recordings/export")
    async def state() -> ExportView:
        """Return the progress of the export."""
        return exports.view

    @router.post("/recordings/export")
    async def start(wanted: NewExport) -> ExportView:
        """Export a recording, or all of a folder; no file is overwritten."""
        exports.start(wanted)
        return exports.view

    @router.delete("/recordings/export")
    async def end() -> ExportView:
        """End the export after the recording that is being written."""
        exports.end()
        return exports.view

    @router.get("/recordings/formats")
    async def formats() -> list[str]:
        """List the formats of an export."""
        return list(FORMATS)


def open_folder(folder: Path) -> None:
    """Open a folder in the system's file manager.

    Raises
    ------
    ConfigError
        ``NOT_FOUND`` if there is no such folder, or no file manager.
    """
    if not folder.is_dir():
        raise ConfigError(ConfigReason.NOT_FOUND, f"there is no folder {folder}")
    try:
        if sys.platform == "win32":
            os.startfile(folder)  # noqa: S606 - a folder, which was looked at
        else:
            program = "open" if sys.platform == "darwin" else "xdg-open"
            subprocess.run([program, str(folder)], check=True, capture_output=True, timeout=10)
    except (OSError, subprocess.SubprocessError) as error:
        message = f"no file manager opens {folder}; open it by hand"
        raise ConfigError(ConfigReason.NOT_FOUND, message) from error


def _judged(path: Path, session: Session) -> Judged:
    recording = read_recording(path)
    # The recording's events come first: today's settings may name other devices and wearers.
    expected = () if tells_devices(recording) else by_devices(session.configured())
    report = judge(recording, expected)
    found = judging.verdict(judging.while_recorded(report) if is_going_on(path) else report)
    judged = Judged(
        colour=found.colour.value,
        sentence=clicked(found.sentence),
        findings=all_explained(found.findings),
        can_be_salvaged=found.can_be_salvaged,
    )
    try:
        with open_contents(path) as contents:
            every = markers(choose(contents, Selection()))
            first = list(islice(every, MOST_MARKERS))
            begin_s = contents.begin_s
            judged.markers = [RecordedMarker(time_s=t - begin_s, text=text) for t, text in first]
            judged.marker_count = len(first) + sum(1 for _ in every)
    except GatewayError as error:
        judged.unread = clicked(str(error))
    return judged


def _salvaged(path: Path, other: Path | None) -> Salvaged:
    require_ended(path)
    outcome = salvage(path, salvaged_path(path), other)
    said = list(salvage_outcome.before_table(outcome))
    if outcome.written is not None:
        rows = salvage_outcome.table(outcome)
        headings = salvage_outcome.HEADINGS
        said += [
            ", ".join(f"{name} {cell}" for name, cell in zip(headings, row, strict=True))
            for row in rows
        ]
        said += salvage_outcome.after_table(outcome)
    return Salvaged(written=str(outcome.written or ""), said=[clicked(each) for each in said])


def _exported(one: Exported) -> ExportedView:
    if one.error:
        said = [one.error]
    elif one.outcome is None:
        said = [f"{one.recording} was already added"]
    else:
        said = list(sentences(one.outcome))
    return ExportedView(
        recording=one.recording.name,
        is_written=not one.error,
        is_certain=one.is_certain,
        said=[clicked(each) for each in said],
    )
