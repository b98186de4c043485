"""``biosensor-gateway run``, as far as its help needs it; `streaming` does the rest."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.cli import KEEP_ALIVE
from biosensor_gateway.cli.options import FaultOption, SettingsOption, SimulateOption
from biosensor_gateway.cli.questions import can_ask
from biosensor_gateway.system.child import start_beside
from biosensor_gateway.system.keep_alive import is_standby, restart_facts

_END_AFTER_MIN = "1"


def run(
    settings: SettingsOption = None,
    simulate: SimulateOption = "",
    fault: FaultOption = None,
    ask: Annotated[
        bool | None,
        typer.Option(
            "--ask/--no-ask",
            help="Ask first: stream, look for sensors, virtual ones. By itself it asks if the "
            "settings name no sensor.",
        ),
    ] = None,
    page: Annotated[
        bool, typer.Option("--page", help="Open the page, too; it needs no questions here.")
    ] = False,
    features: Annotated[
        bool,
        typer.Option(
            "--features", help="Send live features, too: heart rate, skin responses, breaths."
        ),
    ] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log every detail.")] = False,
    _keep_alive: Annotated[
        bool, typer.Option(KEEP_ALIVE, help="Start the agent again whenever it dies.")
    ] = False,
) -> None:
    """Stream all devices of the settings until Ctrl-C, or until it is told to stop."""
    if is_standby():
        from biosensor_gateway.cli.streaming import stand_by  # takes a second

        stand_by(simulate)
    if ask and restart_facts(os.environ):
        # Whoever answered may have left. Settings that name no device still lead to questions.
        ask = None
    if fault and not simulate:
        raise typer.BadParameter("only virtual devices can be given faults; add --simulate")
    if ask and (simulate or not can_ask()):
        raise typer.BadParameter("--ask needs a terminal, and does without --simulate")
    if page and ask is None:
        ask = False
    if page and not restart_facts(os.environ):
        open_page_beside(settings)
    from biosensor_gateway.cli.streaming import stream  # takes a second

    stream(settings, simulate, fault or (), ask=ask, features=features, verbose=verbose)


def open_page_beside(settings: Path | None) -> None:
    """Open the page; it ends by itself when neither a window nor an agent is there any more.

    Parameters
    ----------
    settings
        The file that was named; None for the usual one.

    Raises
    ------
    TransportError
        ``ABSENT`` if the system cannot start it.
    """
    named = [] if settings is None else ["--settings", str(settings.absolute())]
    try:
        start_beside(["page", "--end-after", _END_AFTER_MIN, *named])
    except OSError as error:
        message = f"the page could not be started: {error.strerror or error}"
        raise TransportError(TransportReason.ABSENT, message) from error
