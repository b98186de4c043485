"""``biosensor-gateway xdf``: recordings of LabRecorder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.cli.options import JsonOption, SettingsOption
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.recording.xdf.container import RecordingError
from biosensor_gateway.recording.xdf.expectation import ExpectedStream, by_devices, by_name
from biosensor_gateway.recording.xdf.judging import judge
from biosensor_gateway.recording.xdf.printing import as_json, as_text
from biosensor_gateway.recording.xdf.recording import read_recording
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.places import settings_path

app = typer.Typer(help="Recordings of LabRecorder (XDF files).", no_args_is_help=True)


@app.callback()
def _group() -> None:
    pass


@app.command("check")
def check(
    file: Annotated[Path, typer.Argument(help="The recording.", show_default=False)],
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

    Every stream of every enabled device of the settings is expected in it, as far as
    there are settings. Errors are what is wrong or missing in the file; warnings and
    notes do not change the exit code.
    """
    expected = (*_by_settings(settings), *by_name(expect or ()))
    try:
        recording = read_recording(file)
    except RecordingError as error:
        # The argument was wrong; exit code 1 is for what is wrong in a recording.
        raise ConfigError(ConfigReason.UNREADABLE, str(error)) from error
    report = judge(recording, expected)
    typer.echo(as_json(report) if print_json else as_text(report))
    if not report.is_good:
        raise typer.Exit(1)


def _by_settings(settings: Path | None) -> tuple[ExpectedStream, ...]:
    try:
        loaded = settings_file.load_settings(settings or settings_path(), settings_models())
    except ConfigError as error:
        # Recordings are also checked where no agent ever ran; a broken file is another matter.
        if settings is not None or error.reason is not ConfigReason.NOT_FOUND:
            raise
        return ()
    return by_devices(loaded.devices)
