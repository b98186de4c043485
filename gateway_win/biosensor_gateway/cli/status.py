"""``biosensor-gateway status``: what the running agent does."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from biosensor_common.errors import ConfigError, TransportError, TransportReason
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.state import is_sending
from biosensor_gateway.cli.options import JsonOption
from biosensor_gateway.cli.screen import console, say, table_of_names
from biosensor_gateway.cli.status_words import device_sentence, refusal_sentences, restart_sentences
from biosensor_gateway.settings.places import state_folder

COUNTERS = {"sent": "pushed", "lost": "lost", "refused": "refused", "paused": "withheld"}
"""What became of a stream's samples, in the words of a person and in those of the status."""


def status(
    watch: Annotated[bool, typer.Option("--watch", help="Go on showing it, until Ctrl-C.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Show what the running agent does; exit code 1 if none runs.

    With --watch, a terminal shows a table that is renewed in place, a pipe or a file gets a line
    for each change; with --json, too, one line of JSON a second.
    """
    try:
        current = status_file.running_status(state_folder())
    except ConfigError as error:
        # The command was right: there is no agent.
        raise TransportError(TransportReason.ABSENT, str(error)) from error
    if watch:
        from biosensor_gateway.cli import status_watch  # once does without

        status_watch.watch(state_folder(), as_json=as_json)
    elif as_json:
        typer.echo(json.dumps(current, indent=2))
    else:
        _print_status(current)


def _print_status(current: dict[str, Any]) -> None:
    terminal = console()
    for sentence in (*restart_sentences(current), *refusal_sentences(current)):
        say(sentence)
    if not current["devices"]:
        say(
            "the agent runs, and no device is enabled in its settings; add one with: "
            "biosensor-gateway config edit"
        )
    for device in current["devices"]:
        say(device_sentence(device))
        for sentence in refusal_sentences(device):
            say(f"  {sentence}")
        # What is lost while it does not send is counted when it is back.
        unknown = () if is_sending(device["state"], paused=device["paused"]) else ("lost",)
        rows = [
            (source, *("-" if each in unknown else str(told[each]) for each in COUNTERS.values()))
            for source, told in device["streams"].items()
        ]
        terminal.print(table_of_names(("stream", *COUNTERS), rows, terminal.width))
        for source_id, counters in device["streams"].items():
            for sentence in refusal_sentences(counters):
                say(f"  {source_id}: {sentence}")
