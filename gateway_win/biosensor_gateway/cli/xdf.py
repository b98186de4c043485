"""``biosensor-gateway xdf``: checks, salvages and exports recordings."""

from __future__ import annotations

import math
import sys
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from biosensor_common.errors import ConfigError, ConfigReason, did_you_mean
from biosensor_common.terminal import columns, wrapped
from biosensor_gateway.cli.options import (
    FromOption,
    JsonOption,
    ParticipantOption,
    RecordingArgument,
    SettingsOption,
    StreamsOption,
    UntilOption,
    WithoutOption,
    wrong_recording,
)
from biosensor_gateway.cli.output import console, say, table_of_names
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.recording.contents.choice import Selection
from biosensor_gateway.recording.export import exporter
from biosensor_gateway.recording.export.exporter import FORMATS
from biosensor_gateway.recording.export.job import (
    Exported,
    Task,
    Watch,
    export,
    export_several,
    recordings_in,
)
from biosensor_gateway.recording.export.outcome import (
    Outcome,
    outcome_json,
    outcomes_json,
    sentences,
)
from biosensor_gateway.recording.participants import Whose
from biosensor_gateway.recording.recorder.state import is_going_on, require_ended
from biosensor_gateway.recording.xdf.event_rules import tells_devices
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.report_text import as_json, as_text
from biosensor_gateway.recording.xdf.salvage import outcome as salvage_outcome
from biosensor_gateway.recording.xdf.salvage.outcome import Outcome as Salvaged
from biosensor_gateway.recording.xdf.salvage.outcome import salvage, salvaged_path
from biosensor_gateway.recording.xdf.verdict import (
    ExpectedStream,
    by_devices,
    by_name,
    judge,
    while_recorded,
)
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.places import settings_path
from biosensor_gateway.system.shutdown import requests_interrupt

app = typer.Typer(no_args_is_help=True)


FilesArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="FILE...",
        help="The recordings, or folders of recordings.",
        show_default=False,
    ),
]
FormatsOption = Annotated[
    list[str],
    typer.Option("--to", metavar="FORMAT", help=f"{', '.join(FORMATS)} (repeatable)."),
]
ClockOption = Annotated[
    exporter.Clock, typer.Option(help="LSL time, or Unix time if the recording contains it.")
]
TimesOption = Annotated[
    exporter.Times,
    typer.Option(
        help="Times of streams with a rate: as recorded, or on a straight line between two gaps; "
        "a gap is then an event and does not end a file."
    ),
]
WideOption = Annotated[
    bool,
    typer.Option(
        "--wide", help="For csv: also write one table per rate, with the streams side by side."
    ),
]
RatesOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="HZ",
        help="For edf, kubios and bids: the rate of streams whose headers name none, if you know "
        "it; also NAME=HZ, for one of them (repeatable).",
        show_default=False,
    ),
]
TaskOption = Annotated[
    str, typer.Option(help="For bids; if left out, from the recording's name, or study.")
]
SessionOption = Annotated[
    str, typer.Option(help="For bids; if left out, from the recording's name.")
]
WhoseOption = Annotated[
    Whose | None,
    typer.Option(
        help="Which participant is right if the recording's name and its sensors name different "
        "ones.",
        show_default=False,
    ),
]
OutputOption = Annotated[
    Path | None,
    typer.Option(
        metavar="PLACE",
        help="Folder or new file to write, instead of next to the recording; with --to bids, also "
        "an existing data set, to which recordings are added.",
        show_default=False,
    ),
]


def export_recording(
    files: FilesArgument,
    to: FormatsOption,
    streams: StreamsOption = None,
    participant: ParticipantOption = "",
    without: WithoutOption = "",
    begin: FromOption = "",
    end: UntilOption = "",
    clock: ClockOption = exporter.Clock.LSL,
    times: TimesOption = exporter.Times.RECORDED,
    wide: WideOption = False,
    rate: RatesOption = None,
    task: TaskOption = "",
    session: SessionOption = "",
    whose: WhoseOption = None,
    output: OutputOption = None,
    print_json: JsonOption = False,
) -> None:
    """Write a recording in other formats; exit code 1 if not all of it could be written.

    Exit code 1 also if its name says another participant than its sensors, until --whose says
    which one is right.

    Times are as recorded, with the clock offsets applied; only --times even makes them regular.
    Of a damaged recording, the readable part is exported. No file is overwritten. With --to bids
    and --output, several recordings are added to one data set, which may exist; recordings that
    were added before are not written again.
    """
    _refuse_wrong_formats(to, wide=wide)
    selection = Selection(streams or (), begin, end, participant, without)
    # Brings what writes a data set.
    from biosensor_gateway.recording.export.bids.study import is_dataset

    wanted = Task(
        to,
        selection,
        clock=clock,
        output=output,
        task=task,
        session=session,
        whose=whose,
        times=times,
        is_wide=wide,
        rates=_rates(rate or ()),
    )
    if len(files) == 1 and not files[0].is_dir() and not (output and is_dataset(output)):
        is_certain = _export_one(files[0], wanted, print_json=print_json)
    else:
        recordings, left_out = recordings_in(files)
        for each in left_out:
            typer.echo(f"{each} is left out, because it was salvaged next to it", err=True)
        is_certain = _export_all(recordings, wanted, print_json=print_json)
    if not is_certain:
        raise typer.Exit(1)


def _refuse_wrong_formats(names: Sequence[str], *, wide: bool) -> None:
    for name in names:
        if name not in FORMATS:
            hint = did_you_mean(name, FORMATS)
            message = f"there is no format {name!r}{hint}; there is {', '.join(FORMATS)}"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
    if wide and not {"csv", "csv.gz"} & {*names}:
        message = "--wide needs --to csv or --to csv.gz; other formats have no such tables"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)


def _rates(typed: Sequence[str]) -> dict[str, float]:
    """Return rates in Hz by names of streams; ``*`` is all of them."""
    found: dict[str, float] = {}
    for each in typed:
        name, _, number = each.rpartition("=")
        try:
            rate_hz = float(number)
        except ValueError:
            rate_hz = 0.0
        if not 0 < rate_hz < math.inf:
            message = f"--rate {each}: {number!r} is not a rate in Hz; use 256 or NAME=256"
            raise ConfigError(ConfigReason.WRONG_VALUE, message)
        found[name or "*"] = rate_hz
    # What is of one stream comes before what is of all.
    return dict(sorted(found.items(), key=lambda each: each[0] == "*"))


def _export_one(recording: Path, task: Task, *, print_json: bool) -> bool:
    with wrong_recording(), _bars() as watch:
        outcome = export(recording, task, watch)
    if print_json:
        typer.echo(outcome_json(outcome))
    else:
        _say_outcome(outcome)
    return outcome.is_certain


def _export_all(recordings: Sequence[Path], task: Task, *, print_json: bool) -> bool:
    """Export one recording after the other, and print the outcome of each."""
    results: list[Exported] = []
    for each in export_several(recordings, task, lambda _: _bars()):
        results.append(each)
        if print_json:
            continue
        if each.error:
            typer.echo(wrapped(each.error, columns(sys.stderr), 2), err=True)
        elif each.outcome is None:
            say(f"{each.recording} was already added")
        else:
            say(f"{each.recording}:")
            _say_outcome(each.outcome)
    failed = [(each.recording, each.error) for each in results if each.error]
    if print_json:
        typer.echo(outcomes_json((each.outcome for each in results if each.outcome), failed))
    else:
        say(f"{len(results) - len(failed)} of {len(recordings)} recordings are written")
    return all(each.is_certain for each in results)


def _say_outcome(outcome: Outcome) -> None:
    for sentence in sentences(outcome):
        say(sentence)


@contextmanager
def _bars() -> Generator[Watch]:
    """On a terminal, show a progress bar for each format while the context lasts."""
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
    with Progress(
        *columns,
        TimeRemainingColumn(),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    ) as shown:

        def watch(name: str, seconds: float) -> exporter.Progress:
            task = shown.add_task(name, total=max(seconds, 1e-9))
            return lambda done: shown.update(task, completed=done)

        yield watch


@app.callback()
def _group(context: typer.Context) -> None:
    """Recordings of LabRecorder (XDF files)."""  # noqa: D401 - as the list has it
    context.with_resource(requests_interrupt())


@app.command("check")
def check(
    file: RecordingArgument,
    settings: SettingsOption = None,
    expect: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Expect a stream of this name or source_id, with samples (repeatable).",
        ),
    ] = None,
    print_json: JsonOption = False,
) -> None:
    """Check whether a recording can be trusted; exit code 1 if something is wrong with it.

    The recording must have the devices that its agent's events name. Without such events, or with
    --settings, it must have every stream of every enabled device of the settings. Errors mean
    that something in the file is wrong or missing; warnings and notes do not change the exit
    code.
    """
    with wrong_recording():
        recording = read_recording(file)
    # The recording's events come first: today's settings may name other devices and wearers.
    has_events = settings is None and tells_devices(recording)
    expected = (*(() if has_events else _by_settings(settings)), *by_name(expect or ()))
    report = judge(recording, expected)
    report = while_recorded(report) if is_going_on(file) else report
    typer.echo(as_json(report) if print_json else as_text(report))
    if not report.is_good:
        raise typer.Exit(1)


@app.command("salvage")
def salvage_recording(
    file: RecordingArgument,
    output: Annotated[
        Path | None,
        typer.Option(
            metavar="OTHER",
            help="File to write, instead of NAME_salvaged.xdf next to the recording.",
            show_default=False,
        ),
    ] = None,
    header_from: Annotated[
        Path | None,
        typer.Option(
            metavar="RECORDING",
            help="Another recording of the same streams, to replace lost headers.",
            show_default=False,
        ),
    ] = None,
    print_json: JsonOption = False,
) -> None:
    """Write the readable part of a truncated or damaged recording to another file.

    The recording itself is never changed, and no file is overwritten. If the recording
    is whole, nothing is written.
    """
    require_ended(file)
    with wrong_recording():
        outcome = salvage(file, output or salvaged_path(file), header_from)
    if print_json:
        typer.echo(salvage_outcome.as_json(outcome))
    else:
        _print_outcome(outcome)


app.command("export")(export_recording)


def _print_outcome(outcome: Salvaged) -> None:
    for sentence in salvage_outcome.before_table(outcome):
        say(sentence, hang=4)
    if outcome.written is None:
        return
    terminal = console()
    rows = salvage_outcome.table(outcome)
    terminal.print(table_of_names(salvage_outcome.HEADINGS, rows, terminal.width))
    for sentence in salvage_outcome.after_table(outcome):
        say(sentence)


def _by_settings(settings: Path | None) -> tuple[ExpectedStream, ...]:
    try:
        loaded = settings_file.load_settings(settings or settings_path(), settings_models())
    except ConfigError as error:
        # A computer without an agent has no settings; a broken file is reported all the same.
        if settings is not None or error.reason is not ConfigReason.NOT_FOUND:
            raise
        return ()
    return by_devices(loaded.devices)
