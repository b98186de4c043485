"""``biosensor-gateway record``: LabRecorder, steered by its remote control."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.cli.options import JsonOption, SettingsOption
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.recording.labrecorder.file_name import MAX_RUN, BidsLabels, Place
from biosensor_gateway.recording.labrecorder.remote import DEFAULT_PORT, RemoteControl
from biosensor_gateway.recording.labrecorder.situation import Situation, situation
from biosensor_gateway.recording.labrecorder.starting import GROWTH_S, Order, Started
from biosensor_gateway.recording.labrecorder.starting import start as start_recording
from biosensor_gateway.recording.labrecorder.stopping import Stopped
from biosensor_gateway.recording.labrecorder.stopping import stop as stop_recording
from biosensor_gateway.recording.labrecorder.streams import Presence, expected_devices, look
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.models import GatewaySettings
from biosensor_gateway.settings.places import settings_path, state_folder

app = typer.Typer(help="Start and stop recordings of LabRecorder.", no_args_is_help=True)

HostOption = Annotated[str, typer.Option(help="Computer on which LabRecorder runs.")]
PortOption = Annotated[
    int, typer.Option(min=1, max=65535, help="TCP port of its remote control (RCSPort).")
]
FileOption = Annotated[
    Path | None,
    typer.Option(help="The recording; without it the one that was started from here."),
]
_LOCAL = "127.0.0.1"


@app.callback()
def _group() -> None:
    pass


@app.command("start")
def start(
    file: Annotated[
        Path | None, typer.Option(help="Record to this file (LabRecorder writes it lower-case).")
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(help="Record below this folder; it is looked at to see the file grow."),
    ] = None,
    recorder_folder: Annotated[
        str, typer.Option(help="How LabRecorder's computer calls that folder, if differently.")
    ] = "",
    participant: Annotated[
        str | None, typer.Option(help="Give the file a BIDS name: the participant's pseudonym.")
    ] = None,
    session: Annotated[str | None, typer.Option(help="BIDS session, else S001.")] = None,
    task: Annotated[str | None, typer.Option(help="BIDS task, else Default.")] = None,
    run: Annotated[int | None, typer.Option(min=1, max=MAX_RUN, help="BIDS run, else 1.")] = None,
    acquisition: Annotated[str | None, typer.Option(help="BIDS acquisition, else none.")] = None,
    modality: Annotated[str | None, typer.Option(help="BIDS modality, else beh.")] = None,
    all_streams: Annotated[
        bool, typer.Option("--all", help="Streams of others are wanted, too: no warning.")
    ] = False,
    only_ours: Annotated[
        bool, typer.Option("--only-ours", help="Refuse if there are streams of others.")
    ] = False,
    allow_missing: Annotated[
        bool, typer.Option("--allow-missing", help="Start although streams are missing.")
    ] = False,
    timeout: Annotated[
        float, typer.Option(min=1, help="How many seconds the file may take to grow.")
    ] = GROWTH_S,
    host: HostOption = _LOCAL,
    port: PortOption = DEFAULT_PORT,
    settings: SettingsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Start a recording, and see its file grow; exit code 1 if it does not.

    LabRecorder records every stream that it sees: those that are not of this agent are
    named. It cannot be asked, so only the file tells: give a folder that both see if it
    runs on another computer.
    """
    if all_streams and only_ours:
        raise typer.BadParameter("--all and --only-ours exclude each other")
    labels = _labels(
        participant,
        {"session": session, "task": task, "acquisition": acquisition, "modality": modality},
        run,
    )
    place = Place(folder, recorder_folder, file, labels)
    order = Order(place, all_streams, only_ours, allow_missing, timeout)
    loaded = _loaded(settings)
    with RemoteControl(host, port) as remote:
        started = start_recording(remote, order, partial(_look, loaded), state_folder())
    _warn(started.warnings, silent=as_json)
    typer.echo(_json(started) if as_json else _start_text(started))


def _labels(
    participant: str | None, others: Mapping[str, str | None], run: int | None
) -> BidsLabels | None:
    given = {name: value for name, value in others.items() if value is not None}
    if participant is None:
        if given or run is not None:
            raise typer.BadParameter("a BIDS name needs --participant")
        return None
    return BidsLabels(participant, run=run or 1, **given)


def _look(settings: GatewaySettings) -> Presence:
    return look(settings, expected_devices(settings, state_folder()), socket.gethostname())


def _loaded(path: Path | None) -> GatewaySettings:
    try:
        return settings_file.load_settings(path or settings_path(), settings_models())
    except ConfigError as error:
        # Virtual devices need none, nor does LabRecorder; a broken file is another matter.
        if path is not None or error.reason is not ConfigReason.NOT_FOUND:
            raise
        return GatewaySettings()


def _start_text(started: Started) -> str:
    streams = f"{len(started.streams)} streams seen from here"
    if not started.verified:
        return f"LabRecorder was told to record ({streams}); not verified"
    return (
        f"recording to {started.file}: {started.bytes} bytes and growing "
        f"after {started.took_s:.1f} s ({streams})"
    )


@app.command("stop")
def stop(
    file: FileOption = None,
    host: HostOption = _LOCAL,
    port: PortOption = DEFAULT_PORT,
    as_json: JsonOption = False,
) -> None:
    """End the recording, and see its file closed; exit code 1 if it is not."""
    with RemoteControl(host, port) as remote:
        stopped = stop_recording(remote, file, state_folder())
    _warn(stopped.warnings, silent=as_json)
    typer.echo(_json(stopped) if as_json else _stop_text(stopped))


def _stop_text(stopped: Stopped) -> str:
    if not stopped.verified:
        return "LabRecorder was told to stop; not verified"
    return (
        f"{stopped.file} is closed: {stopped.bytes} bytes, {stopped.streams} streams, "
        f"{stopped.with_samples} of them with samples; look closer with: "
        f"biosensor-gateway xdf check {stopped.file}"
    )


@app.command("status")
def status(
    file: FileOption = None,
    host: HostOption = _LOCAL,
    port: PortOption = DEFAULT_PORT,
    as_json: JsonOption = False,
) -> None:
    """Say what can be known of LabRecorder; exit code 1 if it does not answer."""
    known = situation(host, port, file, state_folder())
    if as_json:
        typer.echo(_json(known, answers=known.answers))
    else:
        typer.echo(f"{host}:{port}: {known.problem or 'LabRecorder answers'}")
        typer.echo(_recording_text(known))
    if not known.answers:
        raise typer.Exit(1)


def _recording_text(known: Situation) -> str:
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


def _warn(warnings: Iterable[str], *, silent: bool) -> None:
    """Say warnings aside of the result; JSON has them in it."""
    for warning in () if silent else warnings:
        typer.echo(f"! {warning}", err=True)


def _json(result: Started | Stopped | Situation, **more: object) -> str:
    return json.dumps({**more, **asdict(result)}, indent=2, default=str)
