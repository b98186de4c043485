"""``biosensor-gateway installation``: what the Windows installer asks its own program to do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_gateway.settings.places import state_folder
from biosensor_gateway.system import windows_autostart, windows_path

app = typer.Typer(help="Used by the Windows installer.", no_args_is_help=True)

FolderArgument = Annotated[str, typer.Argument(help="Folder of the program.")]
EXIT_NOT_CHOSEN = 3
"""Of ``autostart-state``; 1 would also be an error."""
EXIT_HELD = 4
"""Of ``holders``; a version that does not know it ends with 2."""


@app.command("add-to-path")
def add_to_path(folder: FolderArgument) -> None:
    """Let every terminal find the program."""
    _changed(windows_path.add_to_path, folder)


@app.command("remove-from-path")
def remove_from_path(folder: FolderArgument) -> None:
    """Undo it."""
    _changed(windows_path.remove_from_path, folder)


@app.command("autostart")
def autostart(
    command: Annotated[str, typer.Argument(help="What is run; it may have %VARIABLES%.")],
    on: Annotated[bool, typer.Option("--on/--off", help="Start it at logon, or do not.")] = True,
) -> None:
    """Choose whether the user of this session starts the program at logon."""
    _entries(lambda: windows_autostart.choose(command, wanted=on))


@app.command("autostart-state")
def autostart_state() -> None:
    """End with 0 if the user of this session starts the program at logon, else with 3."""
    if not windows_autostart.is_chosen():
        raise typer.Exit(EXIT_NOT_CHOSEN)


@app.command("remove-autostart")
def remove_autostart() -> None:
    """Let no user start the program at logon any more."""
    _entries(windows_autostart.remove_all)


@app.command("holders")
def holders() -> None:
    """Name the programs that run and that cannot be closed by commands; end with 4 if any."""
    from biosensor_gateway.cli.holders import what_cannot_be_closed  # only then

    found = what_cannot_be_closed(state_folder())
    for each in found:
        typer.echo(each)
    if found:
        raise typer.Exit(EXIT_HELD)


def _changed(change: Callable[[str], None], folder: str) -> None:
    try:
        change(folder)
    except ValueError as error:
        message = f"PATH cannot hold it: {error}; install into another folder"
        raise ConfigError(ConfigReason.WRONG_VALUE, message) from error
    except OSError as error:
        message = f"the PATH of this PC cannot be changed: {error.strerror or error}"
        raise TransportError(TransportReason.DENIED, message) from error


def _entries(change: Callable[[], None]) -> None:
    try:
        change()
    except OSError as error:
        message = f"what starts at logon cannot be changed: {error.strerror or error}"
        raise TransportError(TransportReason.DENIED, message) from error
