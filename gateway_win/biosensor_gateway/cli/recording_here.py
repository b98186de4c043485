"""The part of ``biosensor-gateway record`` that needs no window of LabRecorder."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from biosensor_gateway.recording.here.growing_stream import GrowingStream
from biosensor_gateway.recording.here.growth import Growth, Sight
from biosensor_gateway.recording.here.recording import Begun, Ended, Recording, Standing
from biosensor_gateway.recording.labrecorder.errors import LabRecorderError
from biosensor_gateway.recording.labrecorder.remote import RemoteControl
from biosensor_gateway.recording.labrecorder.starting import Order
from biosensor_gateway.recording.labrecorder.streams import Presence, expected_devices, look
from biosensor_gateway.recording.xdf.findings import Finding, Level
from biosensor_gateway.settings.models import GatewaySettings
from biosensor_gateway.settings.places import state_folder

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_WATCH_S = 2.0


def has_window(host: str, port: int) -> bool:
    """Whether LabRecorder's window listens there."""
    try:
        with RemoteControl(host, port):
            return True
    except LabRecorderError:
        return False


def is_of(file: Path | None) -> bool:
    """Whether a file, or whatever is recorded, is what this computer records by itself."""
    recorded = Recording(state_folder()).file
    return recorded is not None and (file is None or file.absolute() == recorded)


def look_for(settings: GatewaySettings) -> Presence:
    """Look for the streams that are to be recorded."""
    return look(settings, expected_devices(settings, state_folder()), socket.gethostname())


def start(order: Order, settings: GatewaySettings, *, counts_up: bool, as_json: bool) -> None:
    """Record by this computer itself."""
    begun = Recording(state_folder()).start(
        order,
        partial(look_for, settings),
        settings.lsl.overrides,
        counts_up=counts_up,
    )
    warn(begun.warnings, silent=as_json)
    typer.echo(as_text(begun, by="gateway") if as_json else _start_text(begun))


def _start_text(begun: Begun) -> str:
    return (
        f"recording to {begun.file}: {len(begun.streams)} streams are open after "
        f"{begun.took_s:.1f} s; look at it with: record status --watch, end it with: record stop"
    )


def stop(*, as_json: bool) -> None:
    """End the recording of this computer itself."""
    ended = Recording(state_folder()).stop()
    warn(ended.warnings, silent=as_json)
    typer.echo(as_text(ended, by="gateway") if as_json else _stop_text(ended))


def _stop_text(ended: Ended) -> str:
    verdict = ended.verdict
    said = [_finding(each) for each in verdict.findings if each.level is not Level.NOTE]
    closed = (
        f"{ended.file} is closed: {ended.bytes} bytes, {ended.streams} streams, "
        f"{ended.with_samples} of them with samples"
    )
    return "\n".join([closed, *said, f"{verdict.colour}: {verdict.sentence}"])


def status(*, watch: bool, as_json: bool) -> None:
    """Say how the recording of this computer itself stands; exit code 1 if not well."""
    recording = Recording(state_folder())
    standing = recording.standing()
    while standing is not None:
        typer.echo(_line(standing) if as_json and watch else _whole(standing, as_json=as_json))
        if not watch or not standing.recording:
            break
        time.sleep(_WATCH_S)
        # Who ends it in the meantime has seen the end of it.
        standing = recording.standing()
    errors = () if standing is None else standing.problems
    if any(each.level is Level.ERROR for each in errors):
        raise typer.Exit(1)


def _line(result: Standing | Sight) -> str:
    return json.dumps(asdict(result), default=str)


def _whole(standing: Standing, *, as_json: bool) -> str:
    if as_json:
        return as_text(standing, by="gateway")
    state = "recording to" if standing.recording else "not recording any more to"
    head = f"{state} {standing.file}"
    return "\n".join([f"{head}{_size(standing.sight)}", *_body(standing.sight, standing.problems)])


def _size(sight: Sight | None) -> str:
    if sight is None:
        return ""
    return f": {sight.length_s:.0f} s, {sight.bytes} bytes, {len(sight.streams)} streams"


def _body(sight: Sight | None, problems: Sequence[Finding]) -> list[str]:
    rows = [] if sight is None else [_row(each) for each in sight.streams]
    return [*rows, *(_finding(each) for each in problems)]


def _row(stream: GrowingStream) -> str:
    if stream.age_s is None:
        return f"    {_safe(stream.name)}: nothing yet"
    return (
        f"    {_safe(stream.name)}: {stream.samples} samples, the newest {stream.age_s:.1f} s ago, "
        f"{stream.clock_offsets} clock offsets"
    )


def watch_file(file: Path, *, as_json: bool) -> None:
    """Say how the file of a window grows, until it is closed."""
    growth = Growth(file)
    while True:
        sight = growth.look()
        text = [f"{file}{_size(sight)}", *_body(sight, growth.problems())]
        typer.echo(_line(sight) if as_json else "\n".join(text))
        if sight.is_closed:
            return
        time.sleep(_WATCH_S)


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


def as_text(result: DataclassInstance, **more: object) -> str:
    """Return a result as JSON."""
    return json.dumps({**more, **asdict(result)}, indent=2, default=str)
