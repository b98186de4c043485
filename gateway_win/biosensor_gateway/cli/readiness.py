"""``biosensor-gateway wait-ready``: until a recording can be started safely."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer

from biosensor_gateway.agent.readiness import Readiness, wait_until_ready
from biosensor_gateway.cli.options import JsonOption
from biosensor_gateway.settings.places import state_folder

TIMEOUT_S = 60.0


def wait_ready(
    timeout: Annotated[float, typer.Option(min=0, help="How many seconds to wait.")] = TIMEOUT_S,
    without: Annotated[
        list[str] | None,
        typer.Option(
            metavar="STREAM",
            help="Do not wait for this stream: source_id or data name, as in ecg (repeatable).",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Wait until all devices of the agent deliver samples; exit code 1 if they do not in time.

    Waited for are the streams that come at a rate. The agent may still be starting.
    """
    readiness = wait_until_ready(state_folder(), timeout, without or ())
    if as_json:
        typer.echo(json.dumps(asdict(readiness), indent=2))
    elif readiness.ready:
        typer.echo(_ready_text(readiness))
    else:
        typer.echo(f"not ready after {readiness.waited_s:.0f} s:", err=True)
        for missing in readiness.missing:
            typer.echo(f"- {missing.sentence}", err=True)
    if not readiness.ready:
        raise typer.Exit(1)


def _ready_text(readiness: Readiness) -> str:
    return (
        f"ready: {readiness.devices} devices deliver samples on {readiness.streams} streams "
        f"(waited {readiness.waited_s:.1f} s)"
    )
