"""``biosensor-gateway page``."""

from __future__ import annotations

import webbrowser
from typing import Annotated

import typer

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.cli.options import SettingsOption
from biosensor_gateway.settings.places import settings_path, state_folder


def page(
    settings: SettingsOption = None,
    browser: Annotated[
        bool, typer.Option("--open/--no-open", help="Open it in the browser, or print its address.")
    ] = True,
) -> None:
    """Show the agent, its devices and their traces in the browser, until Ctrl-C.

    The address opens once, on this computer alone.
    """
    from biosensor_gateway.page.server import PageServer  # noqa: PLC0415 - takes a second

    def ready(address: str) -> None:
        is_open = browser and webbrowser.open(address)
        where = "is open in the browser" if is_open else f"opens once at: {address}"
        typer.echo(f"The page {where}")
        typer.echo("Press Ctrl-C to end the page; the agent goes on.")

    path = (settings or settings_path()).absolute()
    try:
        PageServer(state_folder(), path, ready).run()
    except OSError as error:
        message = f"the page cannot be served: {error.strerror or error}"
        raise TransportError(TransportReason.BUSY, message) from error
