"""``biosensor-gateway reload``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.agent import control
from biosensor_gateway.cli.questions import can_ask, menu
from biosensor_gateway.recording.participants import listed
from biosensor_gateway.recording.recorder.state import file_going_on
from biosensor_gateway.settings.places import state_folder

_SENTENCES = {
    "added": "{} was added",
    "removed": "{} was removed",
    "restarted": "{} was started anew: its entry was changed",
}


def reload(
    while_recording: Annotated[
        bool,
        typer.Option(
            "--while-recording", help="Change devices although a recording loses them by it."
        ),
    ] = False,
) -> None:
    """Have the running agent read its settings again; devices that are the same stream on.

    A file that is broken changes nothing. Exit code 1 if no agent runs or the file is broken.
    While a recording goes on, a change of devices is asked about, and without a terminal
    refused with exit code 2.
    """
    state = state_folder()
    file = file_going_on(state)
    if file is not None and not while_recording:
        _ask_first(file, control.ask(state, "reload-preview"))
    answer = control.ask(state, "reload")
    for line in _lines(answer):
        typer.echo(line)


def _ask_first(file: Path, changes: dict[str, Any]) -> None:
    """Have it confirmed that a recording loses devices.

    Raises
    ------
    ConfigError
        ``IN_USE`` if nobody can be asked.
    typer.Exit
        It is not wanted; with code 2.
    """
    lost = [*changes["removed"], *changes["restarted"], *changes["added"]]
    if not lost:
        return
    sentence = (
        f"a recording goes on, to {file}, and from then on it may hold nothing of {listed(lost)}"
    )
    if not can_ask():
        message = f"{sentence}; end it first, or confirm that with --while-recording"
        raise ConfigError(ConfigReason.IN_USE, message)
    choices = ["Leave it until the recording has ended", "Read the settings now all the same"]
    if menu(f"{sentence[0].upper()}{sentence[1:]}.", choices) == 0:
        raise typer.Exit(2)


def _lines(answer: dict[str, Any]) -> list[str]:
    if answer["pending"]:
        lines = ["the change has begun; a device takes long to end, see: biosensor-gateway status"]
    else:
        lines = [
            sentence.format(name) for key, sentence in _SENTENCES.items() for name in answer[key]
        ]
        lines = lines or ["nothing has changed for any device"]
    for key, from_when in (("now", "now"), ("later", "from the next start of the agent on")):
        if answer[key]:
            sections = ", ".join(f"[{name}]" for name in answer[key])
            lines.append(f"what was changed in {sections} holds {from_when}")
    return lines
