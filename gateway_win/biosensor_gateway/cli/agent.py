"""Commands that control the agent: ``run``, ``stop``, ``pause``, ``resume`` and ``reload``.

This module has what the help of ``run`` needs; :mod:`.agent_process` does the work.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.agent import control, single_instance
from biosensor_gateway.agent.control import USUAL_LIMIT_S, stop_agent
from biosensor_gateway.cli import KEEP_ALIVE
from biosensor_gateway.cli.options import FaultOption, SettingsOption, SimulateOption
from biosensor_gateway.cli.output import can_ask, confirm_while_recording
from biosensor_gateway.settings.places import state_folder
from biosensor_gateway.system.child import start_beside
from biosensor_gateway.system.keep_alive import is_standby, restart_facts

_END_AFTER_MIN = "1"

WhileRecording = Annotated[
    bool,
    typer.Option("--while-recording", help="Do it although a running recording loses sensors."),
]


def run(
    settings: SettingsOption = None,
    simulate: SimulateOption = None,
    fault: FaultOption = None,
    ask: Annotated[
        bool | None,
        typer.Option(
            "--ask/--no-ask",
            help="Ask what to do first: stream, look for sensors, or use virtual ones. It asks "
            "anyway if the settings name no sensor.",
        ),
    ] = None,
    page: Annotated[
        bool, typer.Option("--page", help="Also open the page; then nothing is asked here.")
    ] = False,
    features: Annotated[
        bool,
        typer.Option(
            "--features", help="Also send live features: heart rate, skin responses, breaths."
        ),
    ] = False,
    while_recording: WhileRecording = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log every detail.")] = False,
    _keep_alive: Annotated[
        bool, typer.Option(KEEP_ALIVE, help="Restart the agent whenever it dies.")
    ] = False,
) -> None:
    """Stream all devices of the settings until Ctrl-C, or until it is told to stop.

    A start by which a running recording loses sensors must be confirmed; without a terminal it is
    refused with exit code 2.
    """
    virtual = ",".join(simulate or ())
    if is_standby():
        from biosensor_gateway.cli.agent_process import stand_by  # takes a second

        stand_by(virtual)
    if ask and restart_facts(os.environ):
        # After a restart the person who answered may have left. None still asks if the settings
        # name no device, because there is nothing to stream then.
        ask = None
    _require_possible(is_virtual=bool(simulate), has_fault=bool(fault), asks=bool(ask))
    if page and ask is None:
        ask = False
    if page and not restart_facts(os.environ):
        # Not after a restart: the first process has opened the page, and it is still there.
        _show_page(settings)
    from biosensor_gateway.cli.agent_process import stream  # takes a second

    stream(
        settings,
        virtual,
        fault or (),
        ask=ask,
        while_recording=while_recording,
        features=features,
        verbose=verbose,
    )


def _require_possible(*, is_virtual: bool, has_fault: bool, asks: bool) -> None:
    if has_fault and not is_virtual:
        raise typer.BadParameter("only virtual devices can be given faults; add --simulate")
    if asks and (is_virtual or not can_ask()):
        raise typer.BadParameter("--ask needs a terminal, and cannot be combined with --simulate")


def _show_page(settings: Path | None) -> None:
    open_page_beside(settings)
    # The page's process has no terminal where it could print its address.
    typer.echo(
        "The page opens in your browser; if it does not: biosensor-gateway page --no-open", err=True
    )


def open_page_beside(settings: Path | None) -> None:
    """Start the page's process, which ends when neither a window nor an agent is left.

    Raises
    ------
    TransportError
        ``ABSENT`` if the system cannot start the process.
    """
    named = [] if settings is None else ["--settings", str(settings.absolute())]
    try:
        start_beside(["page", "--end-after", _END_AFTER_MIN, *named])
    except OSError as error:
        message = f"the page could not be started: {error.strerror or error}"
        raise TransportError(TransportReason.ABSENT, message) from error


def stop(
    timeout: Annotated[
        float, typer.Option(min=1, help="How many seconds to wait for the agent to end.")
    ] = USUAL_LIMIT_S,
    while_recording: WhileRecording = False,
) -> None:
    """End the running agent; exit code 1 if none runs or it does not end in time.

    During a recording it must be confirmed; without a terminal it is refused with exit code 2.
    """
    from biosensor_gateway.recording.recorder.state import (  # not for others
        file_going_on,
        said_to_go_on,
    )

    state = state_folder()
    file = file_going_on(state)
    if file is not None and not while_recording and single_instance.is_held(state):
        confirm_while_recording(
            f"a recording goes on, to {file}, and from then on it holds nothing of any sensor",
            ["Leave it until the recording has ended", "End the agent now all the same"],
        )
    typer.echo(stop_agent(state, timeout))
    if sentence := said_to_go_on(state):
        typer.echo(sentence)


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
        f"{name} {before} paused: nothing is sent from it until you run: biosensor-gateway "
        f"resume {_quoted(name)}"
    )
    _fail_if_not_stored(answer, "restarting the agent would stream it again")


def resume(device: DeviceArgument) -> None:
    """Send again what a paused device measures from now on.

    Exit code 1 if no agent runs or there is no such device.
    """
    answer = _ask("resume", device)
    outcome = "is sent again" if answer["changed"] else "was not paused"
    typer.echo(f"{answer['device']} {outcome}")
    _fail_if_not_stored(answer, "restarting the agent would pause it again")


def _ask(command: str, device: str) -> dict[str, Any]:
    """Send a command to the agent, and wait until its effect is stored on disk."""
    folder, deadline = state_folder(), time.monotonic() + control.TIME_LIMIT_S
    answer = first = control.ask(folder, command, {"device": device})
    while answer.get("pending") and time.monotonic() < deadline:
        answer = control.ask(folder, command, {"device": device})
    # A repeated request changes nothing any more, so only the first answer says what changed.
    return answer | {"changed": first["changed"]}


def _fail_if_not_stored(answer: dict[str, Any], consequence: str) -> None:
    if answer["problem"]:
        # The running agent has done it; only an agent that is started later would not know.
        typer.echo(f"biosensor-gateway: {answer['problem']}; {consequence}", err=True)
        raise typer.Exit(1)


def _quoted(name: str) -> str:
    return f'"{name}"' if " " in name else name


_SENTENCES = {
    "added": "{} was added",
    "removed": "{} was removed",
    "restarted": "{} was started again: its entry was changed",
}


def reload(while_recording: WhileRecording = False) -> None:
    """Have the running agent read its settings again; unchanged devices go on streaming.

    A broken file changes nothing. Exit code 1 if no agent runs or the file is broken. During a
    recording, a change of devices must be confirmed; without a terminal it is refused with exit
    code 2.
    """
    from biosensor_gateway.recording.recorder.state import file_going_on  # not for others

    state = state_folder()
    file = file_going_on(state)
    if file is not None and not while_recording:
        _ask_first(file, control.ask(state, "reload-preview"))
    answer = control.ask(state, "reload")
    for line in _lines(answer):
        typer.echo(line)


def _ask_first(file: Path, changes: dict[str, Any]) -> None:
    """Ask a person to confirm that a recording loses devices.

    Raises
    ------
    ConfigError
        ``IN_USE`` if there is no terminal to ask at.
    typer.Exit
        With code 2 if the person declines.
    """
    from biosensor_gateway.recording.participants import listed  # likewise

    lost = [*changes["removed"], *changes["restarted"], *changes["added"]]
    if not lost:
        return
    sentence = (
        f"a recording is running, to {file}, and from then on it may hold nothing from "
        f"{listed(lost)}"
    )
    confirm_while_recording(
        sentence, ["Leave it until the recording has ended", "Read the settings now anyway"]
    )


def _lines(answer: dict[str, Any]) -> list[str]:
    if answer["pending"]:
        lines = ["the change has started; one device is slow to end, see: biosensor-gateway status"]
    else:
        lines = [
            sentence.format(name) for key, sentence in _SENTENCES.items() for name in answer[key]
        ]
        lines = lines or ["nothing has changed for any device"]
    for key, from_when in (("now", "now"), ("later", "from the next start of the agent")):
        if answer[key]:
            sections = ", ".join(f"[{name}]" for name in answer[key])
            lines.append(f"what was changed in {sections} holds {from_when}")
    return lines
