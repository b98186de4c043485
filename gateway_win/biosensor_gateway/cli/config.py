"""``biosensor-gateway config``: the settings file."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import typer

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.system_programs import full_path
from biosensor_gateway.cli import lsl_file
from biosensor_gateway.cli.options import SettingsOption
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.recording.recorder.state import file_going_on
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings import template as settings_template
from biosensor_gateway.settings.places import settings_path, state_folder

if sys.platform == "win32":
    from biosensor_common.system_programs import windows_folder


def open_in_editor(path: Path) -> None:
    """Open a file in the editor that the user has chosen for text.

    Windows: the program for the file's ending, else Notepad; neither is waited for.
    macOS: the text editor. Elsewhere ``$VISUAL`` or ``$EDITOR``, which may need the
    terminal and is waited for, else ``xdg-open``.

    Raises
    ------
    ConfigError
        ``NOT_FOUND`` if there is no editor, ``UNREADABLE`` if it failed.
    """
    if sys.platform == "win32":
        _open_on_windows(path)
    elif sys.platform == "darwin":
        _run(["open", "-t"], path)
    elif editor := os.environ.get("VISUAL") or os.environ.get("EDITOR"):
        _run(_words(editor, path), path)
    elif full_path("xdg-open"):
        _run(["xdg-open"], path)
    else:
        message = f"no editor was found; set EDITOR to yours, or open {path} by hand"
        raise ConfigError(ConfigReason.NOT_FOUND, message)


if sys.platform == "win32":

    def _open_on_windows(path: Path) -> None:
        try:
            os.startfile(path)  # noqa: S606 - that is its purpose
        except OSError:
            # No program is known for the file's ending.
            notepad = str(windows_folder(system=False) / "notepad.exe")
            try:
                subprocess.Popen([notepad, path])
            except OSError as error:
                raise _failed(notepad, path, error.strerror or str(error)) from error


def _words(editor: str, path: Path) -> list[str]:
    try:
        return shlex.split(editor)
    except ValueError as error:
        raise _failed(editor, path, str(error)) from error


def _run(command: Sequence[str], path: Path) -> None:
    name, *options = command or [""]
    program = name if "/" in name else full_path(name)
    if program is None:
        raise _failed(name, path, "no folder of PATH has it")
    try:
        code = subprocess.run([program, *options, path], check=False).returncode
    except OSError as error:
        raise _failed(name, path, error.strerror or str(error)) from error
    if code:
        raise _failed(name, path, f"exit code {code}")


def _failed(editor: str, path: Path, why: str) -> ConfigError:
    message = f"the editor {editor} could not open {path}: {why}; open the file by hand"
    return ConfigError(ConfigReason.UNREADABLE, message)


app = typer.Typer(no_args_is_help=True)


@app.callback()
def _group() -> None:
    """The settings file."""  # noqa: D401 - as the list has it


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
    open_in_editor(path)


@app.command("check")
def check(settings: SettingsOption = None) -> None:
    """Check the settings file; exit code 2 and every problem with its line if it is wrong."""
    path = settings or settings_path()
    loaded = settings_file.load_settings(path, settings_models())
    typer.echo(f"{path}: {len(loaded.devices)} devices, no problem found")
