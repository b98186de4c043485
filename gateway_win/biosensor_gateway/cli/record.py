"""``biosensor-gateway record``: records with LabRecorder's window, or without it."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.agent import status_file
from biosensor_gateway.cli.options import JsonOption, SettingsOption, settings_or_defaults
from biosensor_gateway.cli.output import can_ask, menu
from biosensor_gateway.recording.recorder.labrecorder import (
    DEFAULT_PORT,
    LOCAL_HOST,
    LabRecorder,
    RemoteControl,
)
from biosensor_gateway.recording.recorder.live_file import Growth, Progress, StreamProgress
from biosensor_gateway.recording.recorder.local import LocalRecorder, not_recording
from biosensor_gateway.recording.recorder.presence import own_events
from biosensor_gateway.recording.recorder.request import (
    GROWTH_S,
    MAX_RUN,
    BidsLabels,
    By,
    LocalStatus,
    RecorderError,
    RecordingRequest,
    SensorsAwayError,
    Started,
    Status,
    Stopped,
)
from biosensor_gateway.recording.recorder.state import WindowRecording
from biosensor_gateway.recording.xdf.findings import Finding, Level
from biosensor_gateway.recording.xdf.report_text import finding_lines, printable
from biosensor_gateway.recording.xdf.verdict import Colour
from biosensor_gateway.settings.models import GatewaySettings
from biosensor_gateway.settings.places import state_folder, usual_recordings_folder
from biosensor_gateway.system.shutdown import requests_interrupt

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def start_text(started: Started) -> str:
    """Return a sentence about a started recording."""
    if started.by is By.GATEWAY:
        return (
            f"recording to {started.file}: {len(started.streams)} streams are open after "
            f"{started.took_s:.1f} s; watch it with: record status --watch, end it with: record "
            "stop"
        )
    streams = f"{len(started.streams)} streams seen from here"
    if not started.verified:
        return f"LabRecorder was asked to record ({streams}); not verified"
    return (
        f"recording to {started.file}: {started.bytes} bytes and growing "
        f"after {started.took_s:.1f} s ({streams})"
    )


def stop_text(stopped: Stopped) -> str:
    """Return sentences about an ended recording, with its verdict."""
    if not stopped.verified:
        return "LabRecorder was asked to stop; not verified"
    closed = (
        f"{stopped.file} is closed: {stopped.bytes} bytes, {stopped.streams} streams, "
        f"{stopped.with_samples} of them with samples"
    )
    verdict = stopped.verdict
    if verdict is None:
        return f"{closed}; check it with: biosensor-gateway xdf check {stopped.file}"
    findings = finding_lines([each for each in verdict.findings if each.level is not Level.NOTE])
    return "\n".join([closed, *findings, f"{verdict.colour}: {verdict.sentence}"])


def local_text(status: Status) -> str:
    """Return the status of this computer's recording without LabRecorder."""
    state = "recording to" if status.recording else "no longer recording to"
    return progress_text(f"{state} {status.file}", status.sight, status.problems)


def window_text(where: str, status: Status) -> str:
    """Return the status of the recording by the LabRecorder window at the address *where*."""
    answer = "; ".join(each.text for each in status.problems) or "LabRecorder answers"
    return f"{where}: {answer}\n{_window_recording(status)}"


def _window_recording(known: Status) -> str:
    if known.file is None:
        return (
            "it is not known whether it is recording: it cannot be asked, and no file is known "
            "here (name it with --file)"
        )
    if known.is_closed:
        return f"not recording to {known.file}: it is closed, {known.streams} streams"
    if known.recording:
        return f"recording to {known.file}: it is growing, {known.streams} streams so far"
    size = f"{known.bytes} bytes, not closed" if known.bytes else "empty or missing"
    return f"{known.file} is not growing ({size}): most likely it is not being recorded"


def progress_text(head: str, progress: Progress | None, problems: Sequence[Finding]) -> str:
    """Return the contents of a growing file, and its problems."""
    if progress is None:
        return "\n".join([head, *finding_lines(problems)])
    size = f"{progress.length_s:.0f} s, {progress.bytes} bytes, {len(progress.streams)} streams"
    return "\n".join([f"{head}: {size}", *map(_row, progress.streams), *finding_lines(problems)])


def _row(stream: StreamProgress) -> str:
    if stream.age_s is None:
        return f"    {printable(stream.name)}: nothing yet"
    return (
        f"    {printable(stream.name)}: {stream.samples} samples, the newest {stream.age_s:.1f} s "
        f"ago, {stream.clock_offsets} clock offsets"
    )


def warn(warnings: Iterable[str], *, silent: bool) -> None:
    """Print warnings to stderr, unless *silent*: JSON output contains them."""
    for warning in () if silent else warnings:
        typer.echo(f"! {warning}", err=True)


def as_json_text(result: DataclassInstance, indent: int | None = 2) -> str:
    """Return a result as JSON, in one line if *indent* is None."""
    return json.dumps(asdict(result), indent=indent, default=str)


_WATCH_S = 2.0


def has_window(host: str, port: int) -> bool:
    """Whether a LabRecorder window listens at this address."""
    try:
        with RemoteControl(host, port):
            return True
    except RecorderError:
        return False


def window_may_record(host: str, port: int) -> bool:
    """Whether LabRecorder's window may be recording, because it is open or was told to record."""
    return WindowRecording.last(state_folder()) is not None or has_window(host, port)


def is_local(file: Path | None) -> bool:
    """Whether this computer records without LabRecorder, to this file if one is given."""
    recorded = LocalRecorder(state_folder()).file
    return recorded is not None and (file is None or file.absolute() == recorded)


def without_sensors(request: RecordingRequest, error: SensorsAwayError) -> RecordingRequest:
    """Ask whether to record without the sensors that do not stream.

    Raises
    ------
    SensorsAwayError
        If nobody can answer.
    typer.Exit
        With code 2 if the person declines.
    """
    if not can_ask():
        raise error
    said = " ".join(f"{each.rstrip('.')}." for each in error.sentences)
    if menu(said, ["Do not record yet", "Record without that"]) == 0:
        raise typer.Exit(2)
    return replace(request, without_away=True)


def _status(recording: LocalRecorder) -> LocalStatus | None:
    """Return the status of a recording, compared with that of the agent, as on the page."""
    try:
        agent = status_file.running_status(state_folder())
    except ConfigError as error:
        # One that runs and has written nothing yet is not missing.
        return recording.status(None if error.reason is ConfigReason.NOT_FOUND else ())
    return recording.status(agent["devices"], agent.get("started_s"))


def local_status(*, watch: bool, as_json: bool) -> None:
    """Print the status of a recording that is made without LabRecorder; exit code 1 on errors."""
    recording = LocalRecorder(state_folder())
    indent = None if watch else 2
    status = _status(recording)
    while status is not None:
        typer.echo(as_json_text(status, indent) if as_json else local_text(status))
        if not watch or not status.recording:
            break
        time.sleep(_WATCH_S)
        # None if `record stop` has ended it in the meantime and printed the outcome.
        status = _status(recording)
    errors = () if status is None else status.problems
    if any(each.level is Level.ERROR for each in errors):
        raise typer.Exit(1)


def watch_file(file: Path, *, as_json: bool) -> None:
    """Print the growth of the file of LabRecorder's window until the file is closed."""
    growth = Growth(file)
    while True:
        progress = growth.look()
        started_s = None
        with suppress(ConfigError):
            started_s = status_file.running_status(state_folder()).get("started_s")
        found = (*growth.problems(), *growth.story(own_events(), started_s))
        text = progress_text(str(file), progress, found)
        typer.echo(as_json_text(progress, None) if as_json else text)
        if progress.is_closed:
            return
        time.sleep(_WATCH_S)


app = typer.Typer(no_args_is_help=True)

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
    typer.Option(help="The recording; if left out, the one that was started from here."),
]


NewFileOption = Annotated[
    Path | None,
    typer.Option(help="Record to this file (LabRecorder's window makes it lower-case)."),
]
FolderOption = Annotated[
    Path | None,
    typer.Option(
        help="Record in this folder; it is watched to see the file grow. Without it and without a "
        "window, the page's folder is used: 'Biosensor recordings' in your documents."
    ),
]
RecorderFolderOption = Annotated[
    str, typer.Option(help="That folder's path on LabRecorder's computer, if it differs.")
]
ParticipantOption = Annotated[
    str | None, typer.Option(help="Give the file a BIDS name: the participant's pseudonym.")
]
SessionOption = Annotated[str | None, typer.Option(help="BIDS session; S001 if left out.")]
TaskOption = Annotated[str | None, typer.Option(help="BIDS task; Default if left out.")]
RunOption = Annotated[
    int | None, typer.Option(min=1, max=MAX_RUN, help="BIDS run; the first if left out.")
]
AcquisitionOption = Annotated[str | None, typer.Option(help="BIDS acquisition; none if left out.")]
ModalityOption = Annotated[str | None, typer.Option(help="BIDS modality; beh if left out.")]
AllStreamsOption = Annotated[
    bool, typer.Option("--all", help="Do not warn about other programs' streams.")
]
OnlyOursOption = Annotated[
    bool,
    typer.Option(
        "--only-ours", help="Leave out other programs' streams; LabRecorder's window cannot."
    ),
]
AllowMissingOption = Annotated[
    bool,
    typer.Option(
        "--allow-missing", help="Start even if streams are missing or sensors do not stream."
    ),
]
OtherParticipantsOption = Annotated[
    bool,
    typer.Option(
        "--other-participants",
        help="Start even if someone other than PARTICIPANT wears the sensors.",
    ),
]
TimeoutOption = Annotated[
    float, typer.Option(min=1, help="How many seconds the file may take to grow.")
]
FailOnRedOption = Annotated[
    bool,
    typer.Option(
        "--fail-on-red",
        help="Exit code 1 also if the verdict is red or unknown; the recording is ended anyway.",
    ),
]
HereOption = Annotated[
    bool, typer.Option("--here", help="Always record without LabRecorder's window.")
]
WindowOption = Annotated[
    bool, typer.Option("--window", help="Always record with LabRecorder's window.")
]


@app.callback()
def _group() -> None:
    """Start, watch and stop recordings."""


@app.command("start")
def start(
    file: NewFileOption = None,
    folder: FolderOption = None,
    recorder_folder: RecorderFolderOption = "",
    participant: ParticipantOption = None,
    session: SessionOption = None,
    task: TaskOption = None,
    run: RunOption = None,
    acquisition: AcquisitionOption = None,
    modality: ModalityOption = None,
    all_streams: AllStreamsOption = False,
    only_ours: OnlyOursOption = False,
    allow_missing: AllowMissingOption = False,
    other_participants: OtherParticipantsOption = False,
    timeout: TimeoutOption = GROWTH_S,
    here: HereOption = False,
    window: WindowOption = False,
    host: HostOption = None,
    port: PortOption = None,
    settings: SettingsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Start a recording, and check that it runs; exit code 1 if it does not.

    A file name with another participant than the one who wears the sensors is refused with exit
    code 2. If a sensor is paused or does not stream, you are asked; without a terminal, the
    recording is refused.

    LabRecorder's window records if it is open here or --host names its computer. Otherwise this
    computer records without it, and goes on when this terminal is closed. Every stream is
    recorded; those of other programs are named in a warning. A window cannot be asked, so only
    the file shows that it records: if it is on another computer, give a folder that both can
    reach.
    """
    _refuse(all_streams and only_ours, "--all and --only-ours exclude each other")
    is_window = bool(window or host or port)
    _refuse(here and is_window, "--here excludes --window, --host and --port")
    labels = _labels(
        participant, run, session=session, task=task, acquisition=acquisition, modality=modality
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
    is_here = here or not (is_window or has_window(LOCAL_HOST, DEFAULT_PORT))
    recorder = LocalRecorder(state_folder()) if is_here else _window(host, port)
    with requests_interrupt():
        started = _begin(recorder, request, loaded)
    warn(started.warnings, silent=as_json)
    typer.echo(as_json_text(started) if as_json else start_text(started))


def _refuse(is_wrong: bool, sentence: str) -> None:
    if is_wrong:
        raise typer.BadParameter(sentence)


def _window(host: str | None, port: int | None) -> LabRecorder:
    return LabRecorder(host or LOCAL_HOST, port or DEFAULT_PORT, state_folder())


def _begin(
    recorder: LocalRecorder | LabRecorder, request: RecordingRequest, settings: GatewaySettings
) -> Started:
    if isinstance(recorder, LocalRecorder) and request.file is None and request.folder is None:
        request = replace(request, folder=usual_recordings_folder())
    try:
        return recorder.start(request, settings)
    except SensorsAwayError as error:
        return recorder.start(without_sensors(request, error), settings)


def _labels(participant: str | None, run: int | None, **others: str | None) -> BidsLabels | None:
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
    fail_on_red: FailOnRedOption = False,
    as_json: JsonOption = False,
) -> None:
    """End the recording, and check that its file is closed; exit code 1 if it is not."""
    if not (host or port) and (is_local(file) or _nobody_records(file)):
        stopped = LocalRecorder(state_folder()).stop()
    else:
        stopped = _window(host, port).stop(file)
    warn(stopped.warnings, silent=as_json)
    typer.echo(as_json_text(stopped) if as_json else stop_text(stopped))
    # Not by default: a script must be able to tell it from a recording that goes on.
    if fail_on_red and (stopped.verdict is None or stopped.verdict.colour is Colour.RED):
        raise typer.Exit(1)


def _nobody_records(file: Path | None) -> bool:
    """Whether no window on this computer records or was told to."""
    return file is None and not window_may_record(LOCAL_HOST, DEFAULT_PORT)


@app.command("status")
def status(
    file: FileOption = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="Print it every two seconds, until the recording ends.")
    ] = False,
    host: HostOption = None,
    port: PortOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the state of the recording; exit code 1 if something is wrong with it, or there is none.

    For LabRecorder's window, show what can be known from outside; exit code 1 if it does not
    answer.
    """
    if not (host or port) and is_local(file):
        local_status(watch=watch, as_json=as_json)
        return
    if not (host or port) and _nobody_records(file):
        raise not_recording()
    known = _window(host, port).status(file)
    where = f"{host or LOCAL_HOST}:{port or DEFAULT_PORT}"
    typer.echo(as_json_text(known) if as_json else window_text(where, known))
    if watch and known.file is not None and known.recording:
        watch_file(known.file, as_json=as_json)
    if not known.answers:
        raise typer.Exit(1)
