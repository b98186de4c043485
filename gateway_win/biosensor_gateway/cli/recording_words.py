"""Words and JSON of ``biosensor-gateway record``."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

import typer

from biosensor_gateway.recording.recorder.live_file import Progress, StreamProgress
from biosensor_gateway.recording.recorder.result import By, Started, Status, Stopped
from biosensor_gateway.recording.xdf.findings import Finding, Level

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def start_text(started: Started) -> str:
    """Say that it was started."""
    if started.by is By.GATEWAY:
        return (
            f"recording to {started.file}: {len(started.streams)} streams are open after "
            f"{started.took_s:.1f} s; look at it with: record status --watch, end it with: "
            "record stop"
        )
    streams = f"{len(started.streams)} streams seen from here"
    if not started.verified:
        return f"LabRecorder was told to record ({streams}); not verified"
    return (
        f"recording to {started.file}: {started.bytes} bytes and growing "
        f"after {started.took_s:.1f} s ({streams})"
    )


def stop_text(stopped: Stopped) -> str:
    """Say that it was ended, and what it is worth."""
    if not stopped.verified:
        return "LabRecorder was told to stop; not verified"
    closed = (
        f"{stopped.file} is closed: {stopped.bytes} bytes, {stopped.streams} streams, "
        f"{stopped.with_samples} of them with samples"
    )
    verdict = stopped.verdict
    if verdict is None:
        return f"{closed}; look closer with: biosensor-gateway xdf check {stopped.file}"
    said = [_finding(each) for each in verdict.findings if each.level is not Level.NOTE]
    return "\n".join([closed, *said, f"{verdict.colour}: {verdict.sentence}"])


def standing_text(standing: Status) -> str:
    """Say how a recording of this computer itself stands."""
    state = "recording to" if standing.recording else "not recording any more to"
    return sight_text(f"{state} {standing.file}", standing.sight, standing.problems)


def window_text(where: str, standing: Status) -> str:
    """Say how a recording of LabRecorder's window stands, which listens there."""
    said = "; ".join(each.text for each in standing.problems) or "LabRecorder answers"
    return f"{where}: {said}\n{_window_recording(standing)}"


def _window_recording(known: Status) -> str:
    if known.file is None:
        return (
            "whether it records is not known: it cannot be asked, and no file is known here "
            "(name it with --file)"
        )
    if known.is_closed:
        return f"not recording to {known.file}: it is closed, {known.streams} streams"
    if known.recording:
        return f"recording to {known.file}: it grows, {known.streams} streams so far"
    size = f"{known.bytes} bytes, not closed" if known.bytes else "empty or not there"
    return f"{known.file} does not grow ({size}): most likely it is not being recorded"


def sight_text(head: str, sight: Progress | None, problems: Sequence[Finding]) -> str:
    """Say what is in a growing file, and what is wrong with it."""
    if sight is None:
        return "\n".join([head, *map(_finding, problems)])
    size = f"{sight.length_s:.0f} s, {sight.bytes} bytes, {len(sight.streams)} streams"
    return "\n".join([f"{head}: {size}", *map(_row, sight.streams), *map(_finding, problems)])


def _row(stream: StreamProgress) -> str:
    if stream.age_s is None:
        return f"    {_safe(stream.name)}: nothing yet"
    return (
        f"    {_safe(stream.name)}: {stream.samples} samples, the newest {stream.age_s:.1f} s ago, "
        f"{stream.clock_offsets} clock offsets"
    )


def _finding(finding: Finding) -> str:
    where = f"{_safe(finding.stream)}: " if finding.stream else ""
    return f"{finding.level}: {where}{_safe(finding.text)}"


def _safe(text: str) -> str:
    """Keep what a stranger wrote from steering the terminal."""
    return "".join(char if char.isprintable() else "\N{REPLACEMENT CHARACTER}" for char in text)


def warn(warnings: Iterable[str], *, silent: bool) -> None:
    """Say warnings aside of the result; JSON has them in it."""
    for warning in () if silent else warnings:
        typer.echo(f"! {warning}", err=True)


def as_text(result: DataclassInstance) -> str:
    """Return a result as JSON."""
    return json.dumps(asdict(result), indent=2, default=str)


def as_line(result: DataclassInstance) -> str:
    """Return a result as JSON in one line."""
    return json.dumps(asdict(result), default=str)
