"""``biosensor-gateway config``: the settings file."""

from __future__ import annotations

import typer

from biosensor_gateway.cli import editor, lsl_file
from biosensor_gateway.cli.options import SettingsOption
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.recording.going_on import file_going_on
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings import template as settings_template
from biosensor_gateway.settings.places import settings_path, state_folder

app = typer.Typer(help="The settings file.", no_args_is_help=True)
app.command("lsl")(lsl_file.write_lsl_file)


@app.command("path")
def print_path() -> None:
    """Print where the settings file is."""
    typer.echo(settings_path())


@app.command("init")
def write_template(settings: SettingsOption = None) -> None:
    """Write a settings file with every setting explained; never overwrites."""
    path = settings or settings_path()
    settings_template.write_template(path, settings_models())
    typer.echo(f"wrote {path}; add your devices there")


@app.command("edit")
def edit(settings: SettingsOption = None) -> None:
    """Open the settings file in your editor; write it first if there is none."""
    recorded = file_going_on(state_folder())
    if recorded is not None:
        warning = (
            f"a recording goes on, to {recorded}: do not reload before it has ended, or it may "
            "lose the devices that you change"
        )
        typer.echo(f"! {warning}", err=True)
    path = (settings or settings_path()).absolute()
    if not path.exists():
        settings_template.write_template(path, settings_models())
        typer.echo(f"wrote {path}")
    editor.open_in_editor(path)


@app.command("check")
def check(settings: SettingsOption = None) -> None:
    """Check the settings file; exit code 2 and every problem with its line if it is wrong."""
    path = settings or settings_path()
    loaded = settings_file.load_settings(path, settings_models())
    typer.echo(f"{path}: {len(loaded.devices)} devices, no problem found")
