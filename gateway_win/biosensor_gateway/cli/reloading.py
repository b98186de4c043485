"""``biosensor-gateway reload``."""

from __future__ import annotations

from typing import Any

import typer

from biosensor_gateway.agent import control
from biosensor_gateway.settings.places import state_folder

_SENTENCES = {
    "added": "{} was added",
    "removed": "{} was removed",
    "restarted": "{} was started anew: its entry was changed",
}


def reload() -> None:
    """Have the running agent read its settings again; devices that are the same stream on.

    A file that is broken changes nothing. Exit code 1 if no agent runs or the file is broken.
    """
    answer = control.ask(state_folder(), "reload")
    for line in _lines(answer):
        typer.echo(line)


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
