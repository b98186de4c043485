"""``biosensor-gateway record``: by LabRecorder's window, or by this computer itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from biosensor_gateway.cli import recording_here
from biosensor_gateway.cli.loading import settings_or_defaults
from biosensor_gateway.cli.options import JsonOption, SettingsOption
from biosensor_gateway.cli.recording_words import as_text, start_text, stop_text, warn, window_text
from biosensor_gateway.recording.recorder.labrecorder import DEFAULT_PORT, LOCAL_HOST, LabRecorder
from biosensor_gateway.recording.recorder.local import LocalRecorder, not_recording
from biosensor_gateway.recording.recorder.request import (
    GROWTH_S,
    MAX_RUN,
    BidsLabels,
    RecordingRequest,
    SensorsAwayError,
)
from biosensor_gateway.recording.recorder.result import Started
from biosensor_gateway.recording.recorder.streams import look
from biosensor_gateway.settings.places import state_folder
from biosensor_gateway.system.cloud_folders import usual_recordings_folder

app = typer.Typer(help="Start, watch and stop recordings.", no_args_is_help=True)

HostOption = Annotated[
    str | None,
    typer.Option(help="Computer on which LabRecorder's window is open.", show_default=LOCAL_HOST),
]
PortOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        max=65535,
        help="TCP port of its remote control (RCSPort).",
        show_default=str(DEFAULT_PORT),
    ),
]
FileOption = Annotated[
    Path | None,
    typer.Option(help="The recording; without it the one that was started from here."),
]


@app.callback()
def _group() -> None:
    pass


@app.command("start")
def start(
    file: Annotated[
        Path | None,
        typer.Option(help="Record to this file (LabRecorder's window makes it lower-case)."),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(
            help="Record below this folder; it is looked at to see the file grow. Without a "
            "window it is the page's, 'Biosensor recordings' among your documents, if you name "
            "none."
        ),
    ] = None,
    recorder_folder: Annotated[
        str, typer.Option(help="How LabRecorder's computer calls that folder, if differently.")
    ] = "",
    participant: Annotated[
        str | None, typer.Option(help="Give the file a BIDS name: the participant's pseudonym.")
    ] = None,
    session: Annotated[str | None, typer.Option(help="BIDS session, else S001.")] = None,
    task: Annotated[str | None, typer.Option(help="BIDS task, else Default.")] = None,
    run: Annotated[
        int | None, typer.Option(min=1, max=MAX_RUN, help="BIDS run, else the first.")
    ] = None,
    acquisition: Annotated[str | None, typer.Option(help="BIDS acquisition, else none.")] = None,
    modality: Annotated[str | None, typer.Option(help="BIDS modality, else beh.")] = None,
    all_streams: Annotated[
        bool, typer.Option("--all", help="Streams of others are wanted, too: no warning.")
    ] = False,
    only_ours: Annotated[
        bool, typer.Option("--only-ours", help="No streams of others; a window refuses then.")
    ] = False,
    allow_missing: Annotated[
        bool,
        typer.Option(
            "--allow-missing", help="Start although streams are missing, or sensors do not stream."
        ),
    ] = False,
    other_participants: Annotated[
        bool,
        typer.Option(
            "--other-participants", help="Start although others than PARTICIPANT wear the sensors."
        ),
    ] = False,
    timeout: Annotated[
        float, typer.Option(min=1, help="How many seconds the file may take to grow.")
    ] = GROWTH_S,
    here: Annotated[
        bool, typer.Option("--here", help="Record without LabRecorder's window in any case.")
    ] = False,
    window: Annotated[
        bool, typer.Option("--window", help="Record with LabRecorder's window in any case.")
    ] = False,
    host: HostOption = None,
    port: PortOption = None,
    settings: SettingsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Start a recording, and see that it runs; exit code 1 if it does not.

    A file that is called after somebody else than who wears the sensors is refused with exit
    code 2. If a sensor is paused or does not stream, a terminal is asked, and else it is refused.

    LabRecorder's window records if it is open here or --host names its computer, else this
    computer by itself, and goes on when this terminal is closed. Every stream is recorded:
    those that are not of this agent are named. A window cannot be asked, so only the file
    tells: give a folder that both see if it is on another computer.
    """
    if all_streams and only_ours:
        raise typer.BadParameter("--all and --only-ours exclude each other")
    if here and (window or host or port):
        raise typer.BadParameter("--here excludes --window, --host and --port")
    labels = _labels(
        participant,
        {"session": session, "task": task, "acquisition": acquisition, "modality": modality},
        run,
    )
    request = RecordingRequest(
        folder,
        recorder_folder,
        file,
        labels,
        all_streams=all_streams,
        only_ours=only_ours,
        allow_missing=allow_missing,
        without_away=allow_missing,
        other_participants=other_participants,
        growth_s=timeout,
        counts_up=run is None,
    )
    loaded = settings_or_defaults(settings)
    is_here = here or not (
        window or host or port or recording_here.has_window(LOCAL_HOST, DEFAULT_PORT)
    )

    if is_here and file is None and folder is None:
        request = replace(request, folder=usual_recordings_folder())

    def begin(request: RecordingRequest) -> Started:
        streams = partial(look, loaded, state_folder())
        if is_here:
            return LocalRecorder(state_folder()).start(request, streams, loaded.lsl.overrides)
        return _window(host, port).start(request, streams)

    try:
        started = begin(request)
    except SensorsAwayError as error:
        started = begin(recording_here.without_sensors(request, error))
    warn(started.warnings, silent=as_json)
    typer.echo(as_text(started) if as_json else start_text(started))


def _window(host: str | None, port: int | None) -> LabRecorder:
    return LabRecorder(host or LOCAL_HOST, port or DEFAULT_PORT, state_folder())


def _labels(
    participant: str | None, others: Mapping[str, str | None], run: int | None
) -> BidsLabels | None:
    given = {name: value for name, value in others.items() if value is not None}
    if participant is None:
        if given or run is not None:
            raise typer.BadParameter("a BIDS name needs --participant")
        return None
    return BidsLabels(participant, run=run or 1, **given)


@app.command("stop")
def stop(
    file: FileOption = None,
    host: HostOption = None,
    port: PortOption = None,
    as_json: JsonOption = False,
) -> None:
    """End the recording, and see its file closed; exit code 1 if it is not."""
    if not (host or port) and (recording_here.is_of(file) or _is_nothing(file)):
        stopped = LocalRecorder(state_folder()).stop()
    else:
        stopped = _window(host, port).stop(file)
    warn(stopped.warnings, silent=as_json)
    typer.echo(as_text(stopped) if as_json else stop_text(stopped))


def _is_nothing(file: Path | None) -> bool:
    """Whether nobody here records or was told to."""
    return file is None and not recording_here.may_be_of_window(LOCAL_HOST, DEFAULT_PORT)


@app.command("status")
def status(
    file: FileOption = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="Say it every two seconds, until the recording ends.")
    ] = False,
    host: HostOption = None,
    port: PortOption = None,
    as_json: JsonOption = False,
) -> None:
    """Say how the recording stands; exit code 1 if something is wrong with it, or there is none.

    Of LabRecorder's window, what can be known of it; exit code 1 if it does not answer.
    """
    if not (host or port) and recording_here.is_of(file):
        recording_here.status(watch=watch, as_json=as_json)
        return
    if not (host or port) and _is_nothing(file):
        raise not_recording()
    known = _window(host, port).status(file)
    where = f"{host or LOCAL_HOST}:{port or DEFAULT_PORT}"
    typer.echo(as_text(known) if as_json else window_text(where, known))
    if watch and known.file is not None and known.recording:
        recording_here.watch_file(known.file, as_json=as_json)
    if not known.answers:
        raise typer.Exit(1)
