"""``biosensor-gateway installation``: what the Windows installer asks its own program to do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_gateway.system import windows_path

app = typer.Typer(help="Used by the Windows installer.", no_args_is_help=True)

FolderArgument = Annotated[str, typer.Argument(help="Folder of the program.")]


@app.command("add-to-path")
def add_to_path(folder: FolderArgument) -> None:
    """Let every terminal find the program."""
    _changed(windows_path.add_to_path, folder)


@app.command("remove-from-path")
def remove_from_path(folder: FolderArgument) -> None:
    """Undo it."""
    _changed(windows_path.remove_from_path, folder)


def _changed(change: Callable[[str], None], folder: str) -> None:
    try:
        change(folder)
    except ValueError as error:
        message = f"PATH cannot hold it: {error}; install into another folder"
        raise ConfigError(ConfigReason.WRONG_VALUE, message) from error
    except OSError as error:
        message = f"the PATH of this PC cannot be changed: {error.strerror or error}"
        raise TransportError(TransportReason.DENIED, message) from error
