"""``biosensor-gateway status``: what the running agent does."""

from __future__ import annotations

import json
from typing import Any

import typer

from biosensor_common.errors import ConfigError, TransportError, TransportReason
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.state import STATE_WORDS
from biosensor_gateway.cli.options import JsonOption
from biosensor_gateway.cli.screen import console, say, table_of_names
from biosensor_gateway.settings.places import state_folder


def status(as_json: JsonOption = False) -> None:
    """Show what the running agent does; exit code 1 if none runs."""
    try:
        current = status_file.running_status(state_folder())
    except ConfigError as error:
        # The command was right: there is no agent.
        raise TransportError(TransportReason.ABSENT, str(error)) from error
    if as_json:
        typer.echo(json.dumps(current, indent=2))
    else:
        _print_status(current)


def _print_status(current: dict[str, Any]) -> None:
    terminal = console()
    if "restarts" in current:
        times = "once" if current["restarts"] == 1 else f"{current['restarts']} times"
        say(f"started again {times}, last after: {current['last_end']}")
    if not current["devices"]:
        say(
            "the agent runs, and no device is enabled in its settings; add one with: "
            "biosensor-gateway config edit"
        )
    for device in current["devices"]:
        name = " ".join(
            part for part in (device["participant"], device["sensor"], device["label"]) if part
        )
        word = STATE_WORDS.get(device["state"], device["state"])
        state = f"paused ({word})" if device["paused"] else word
        line = f"{name} ({device['unit']}): {state}"
        say(line + (f" - {device['error']}" if device["error"] else ""))
        columns = ("pushed", "lost", "refused", "withheld")
        rows = [
            (source_id, *(str(counters[column]) for column in columns))
            for source_id, counters in device["streams"].items()
        ]
        terminal.print(table_of_names(("stream", *columns), rows, terminal.width))
