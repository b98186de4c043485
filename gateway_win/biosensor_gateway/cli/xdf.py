"""``biosensor-gateway xdf``: recordings of LabRecorder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.cli.options import JsonOption, SettingsOption
from biosensor_gateway.cli.recordings import RecordingArgument, wrong_recording
from biosensor_gateway.cli.screen import console, say, table_of_names
from biosensor_gateway.cli.xdf_export import export_recording
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.recording.xdf.event_rules import tells_devices
from biosensor_gateway.recording.xdf.expectation import ExpectedStream, by_devices, by_name
from biosensor_gateway.recording.xdf.judging import judge
from biosensor_gateway.recording.xdf.printing import as_json, as_text
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.recording.xdf.salvage import printing as salvage_printing
from biosensor_gateway.recording.xdf.salvage.outcome import Outcome, salvage, salvaged_path
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.places import settings_path

app = typer.Typer(help="Recordings of LabRecorder (XDF files).", no_args_is_help=True)


@app.callback()
def _group() -> None:
    pass


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
    """Say whether a recording can be trusted; exit code 1 if something is wrong with it.

    Expected are the devices that its agent names in it. Of a recording without an agent's
    events, or with --settings, every stream of every enabled device of the settings is
    expected. Errors are what is wrong or missing in the file; warnings and notes do not
    change the exit code.
    """
    with wrong_recording():
        recording = read_recording(file)
    # Today's settings say nothing of another day, on which others wore the sensors.
    is_told = settings is None and tells_devices(recording)
    expected = (*(() if is_told else _by_settings(settings)), *by_name(expect or ()))
    report = judge(recording, expected)
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
            help="File to write, instead of NAME_salvaged.xdf beside the recording.",
            show_default=False,
        ),
    ] = None,
    print_json: JsonOption = False,
) -> None:
    """Write what can be read of a cut or damaged recording to another file.

    The recording itself is never changed, and no file is overwritten. If the recording
    is whole, nothing is written.
    """
    with wrong_recording():
        outcome = salvage(file, output or salvaged_path(file))
    if print_json:
        typer.echo(salvage_printing.as_json(outcome))
    else:
        _print_outcome(outcome)


app.command("export")(export_recording)


def _print_outcome(outcome: Outcome) -> None:
    for sentence in salvage_printing.before_table(outcome):
        say(sentence, hang=4)
    if outcome.written is None:
        return
    terminal = console()
    rows = salvage_printing.table(outcome)
    terminal.print(table_of_names(salvage_printing.HEADINGS, rows, terminal.width))
    for sentence in salvage_printing.after_table(outcome):
        say(sentence)


def _by_settings(settings: Path | None) -> tuple[ExpectedStream, ...]:
    try:
        loaded = settings_file.load_settings(settings or settings_path(), settings_models())
    except ConfigError as error:
        # Recordings are also checked where no agent ever ran; a broken file is another matter.
        if settings is not None or error.reason is not ConfigReason.NOT_FOUND:
            raise
        return ()
    return by_devices(loaded.devices)
