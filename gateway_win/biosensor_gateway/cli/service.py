"""``biosensor-gateway service``: the agent as a service of this user, on Linux."""

from __future__ import annotations

import typer

from biosensor_gateway.cli import KEEP_ALIVE
from biosensor_gateway.cli.options import SettingsOption
from biosensor_gateway.system import systemd

app = typer.Typer(no_args_is_help=True)


@app.callback()
def _group() -> None:
    """The agent as a service of this user (Linux)."""  # noqa: D401 - as the list has it


@app.command()
def install(settings: SettingsOption = None) -> None:
    """Run the agent now, whenever you are logged in, and again whenever it dies."""
    chosen = () if settings is None else ("--settings", str(settings.resolve()))
    path = systemd.install(("run", KEEP_ALIVE, *chosen))
    typer.echo(
        f"the agent runs as a service ({path})\n"
        "look at it:      biosensor-gateway status\n"
        "end it for now:  biosensor-gateway stop\n"
        "to have it run from the computer's start on, without a login: loginctl enable-linger"
    )


@app.command()
def remove() -> None:
    """End the service, and remove it."""
    typer.echo("the service is removed" if systemd.remove() else "there is no service")
