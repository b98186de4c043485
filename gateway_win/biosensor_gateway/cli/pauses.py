"""``biosensor-gateway pause`` and ``resume``: a participant withdraws, or comes back."""

from __future__ import annotations

import time
from typing import Annotated, Any

import typer

from biosensor_gateway.agent import control
from biosensor_gateway.settings.places import state_folder

DeviceArgument = Annotated[
    str,
    typer.Argument(
        metavar="DEVICE",
        help="Sensor, label or participant, or SENSOR/UNIT, as `status` shows them.",
    ),
]


def pause(device: DeviceArgument) -> None:
    """Send nothing of a device from now on, also after a restart, until it is resumed.

    The device stays connected. Exit code 1 if no agent runs or there is no such device.
    """
    answer = _ask("pause", device)
    name = answer["device"]
    before = "is" if answer["changed"] else "was already"
    typer.echo(
        f"{name} {before} paused: nothing of it is sent until: "
        f"biosensor-gateway resume {_quoted(name)}"
    )
    _complain(answer, "a new start of the agent would stream it again")


def resume(device: DeviceArgument) -> None:
    """Send again what a paused device measures from now on.

    Exit code 1 if no agent runs or there is no such device.
    """
    answer = _ask("resume", device)
    outcome = "is sent again" if answer["changed"] else "was not paused"
    typer.echo(f"{answer['device']} {outcome}")
    _complain(answer, "a new start of the agent would pause it again")


def _ask(command: str, device: str) -> dict[str, Any]:
    """Have it done, and wait for the disk as long as for the agent."""
    folder, deadline = state_folder(), time.monotonic() + control.TIME_LIMIT_S
    answer = first = control.ask(folder, command, {"device": device})
    while answer.get("pending") and time.monotonic() < deadline:
        answer = control.ask(folder, command, {"device": device})
    return answer | {"changed": first["changed"]}


def _complain(answer: dict[str, Any], consequence: str) -> None:
    if answer["problem"]:
        # It is done; only the next agent does not know.
        typer.echo(f"biosensor-gateway: {answer['problem']}; {consequence}", err=True)
        raise typer.Exit(1)


def _quoted(name: str) -> str:
    return f'"{name}"' if " " in name else name
