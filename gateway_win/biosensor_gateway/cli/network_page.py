"""``biosensor-gateway page --lsl``."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import typer

from biosensor_common.errors import TransportError, TransportReason
from biosensor_common.heap import limit_arenas


def serve_network(settings: Path, show: Callable[[str], None]) -> None:
    """Show the LSL streams that arrive here, until Ctrl-C.

    Parameters
    ----------
    settings
        A settings file, of which the LSL section counts.
    show
        Opens an address in the browser, or prints it.

    Raises
    ------
    ConfigError
        The settings are wrong.
    TransportError
        The page cannot be served.
    """
    from biosensor_gateway.page.network_page.server import (
        NetworkServer,  # takes a fifth of a second
    )

    def ready(address: str) -> None:
        show(address)
        typer.echo("Press Ctrl-C to end the page; no stream is touched.")

    # Inlets come and go with what is looked at, each with threads.
    limit_arenas(os.environ)
    try:
        NetworkServer(settings, ready).run()
    except OSError as error:
        message = f"the page cannot be served: {error.strerror or error}"
        raise TransportError(TransportReason.BUSY, message) from error
