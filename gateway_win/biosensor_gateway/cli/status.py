"""Commands that show the agent's state: ``status``, ``clocks``, ``wait-ready``."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Group
from rich.live import Live
from rich.table import Table

from biosensor_common.errors import ConfigError, TransportError, TransportReason
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.device_states import is_sending
from biosensor_gateway.cli.options import JsonOption
from biosensor_gateway.cli.output import (
    console,
    device_sentence,
    refusal_sentences,
    restart_sentences,
    say,
    table_of_names,
)
from biosensor_gateway.settings.places import state_folder

if TYPE_CHECKING:
    from biosensor_gateway.agent.readiness import Readiness

COUNTERS = {"sent": "pushed", "lost": "lost", "refused": "refused", "paused": "withheld"}
"""Headings for people, and the status's counters of a stream's samples below them."""


def status(
    watch: Annotated[bool, typer.Option("--watch", help="Keep showing it, until Ctrl-C.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Show what the running agent does; exit code 1 if none runs.

    With --watch, a terminal shows a table that is updated in place, and a pipe or a file gets a
    line for each change; with --watch --json, one line of JSON per second.
    """
    current = _status()
    if watch:
        from biosensor_gateway.cli import live_table  # only needed for --watch

        live_table.watch(state_folder(), as_json=as_json)
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
            "the agent is running, but no device is enabled in its settings; add one with: "
            "biosensor-gateway config edit"
        )
    for device in current["devices"]:
        say(device_sentence(device))
        for sentence in refusal_sentences(device):
            say(f"  {sentence}")
        # What a device loses while it does not send is counted only when it is back.
        unknown = () if is_sending(device["state"], paused=device["paused"]) else ("lost",)
        rows = [
            (source, *("-" if each in unknown else str(counts[each]) for each in COUNTERS.values()))
            for source, counts in device["streams"].items()
        ]
        terminal.print(table_of_names(("stream", *COUNTERS), rows, terminal.width))
        for source_id, counters in device["streams"].items():
            for sentence in refusal_sentences(counters):
                say(f"  {source_id}: {sentence}")


_EVERY_S = 1.0
_HEADINGS = ("device", "offset s", "drift ppm", "RMS ms", "jumps", "age s")


def clocks(
    watch: Annotated[
        bool, typer.Option("--watch", help="Print again every second, until Ctrl-C.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Show how the devices' clocks are mapped to LSL's clock; exit code 1 if no agent runs.

    Offset: LSL time minus device time. Drift: by how many microseconds per second the device's
    clock is slow. RMS: how far the earliest packets are from the fitted line. Jumps: how often
    the mapping was restarted. Age: time since the newest sample was measured. None: the device
    has no clock, or nothing was received from it yet.
    """
    # Ctrl-C is the usual end, not a failure.
    with contextlib.suppress(KeyboardInterrupt):
        if as_json:
            _print_json(watch=watch)
        elif watch:
            _watch()
        else:
            terminal = console()
            terminal.print(_table(_status(), terminal.width))


def _status() -> dict[str, Any]:
    try:
        return status_file.running_status(state_folder())
    except ConfigError as error:
        # Exit code 1: the command was right, but no agent runs.
        raise TransportError(TransportReason.ABSENT, str(error)) from error


def _print_json(*, watch: bool) -> None:
    while True:
        # While watching, one report per line, for programs that read lines.
        typer.echo(json.dumps(report(_status()), indent=None if watch else 2))
        if not watch:
            return
        time.sleep(_EVERY_S)


def _watch() -> None:
    with Live(Group(), auto_refresh=False) as live:
        while True:
            live.update(_table(_status(), live.console.width), refresh=True)
            time.sleep(_EVERY_S)


def report(status: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of an agent's status that is about clocks.

    Returns
    -------
    dict
        ``written`` (Unix time, s), ``process``, and ``clocks``, with an entry for each device:
        its identity, its state, and ``clock``, which is None while the device has none.
    """
    devices = status["devices"]
    return {
        "written": status["written"],
        "process": status["process"],
        "clocks": [_entry(device, status.get("lsl_time")) for device in devices],
    }


def _entry(device: Mapping[str, Any], lsl_time: float | None) -> dict[str, Any]:
    clock: dict[str, Any] | None = device["clock"]
    if clock is not None:
        newest: float | None = clock.get("newest_s")
        age = None if lsl_time is None or newest is None else lsl_time - newest
        clock = {**clock, "age_s": age}
    names = ("sensor", "unit", "participant", "label", "state")
    return {**{name: device[name] for name in names}, "clock": clock}


def _table(status: Mapping[str, Any], width: int) -> Table:
    rows: list[tuple[str, ...]] = []
    for entry in report(status)["clocks"]:
        parts = (entry["participant"], entry["sensor"], entry["label"], f"({entry['unit']})")
        name = " ".join(part for part in parts if part)
        state = "" if entry["state"] == "streaming" else f", {entry['state']}"
        rows.append((f"{name}{state}", *_figures(entry["clock"])))
    return table_of_names(_HEADINGS, rows, width)


def _figures(clock: Mapping[str, Any] | None) -> tuple[str, ...]:
    if clock is None:
        return ("none", "", "", "", "")
    age = clock["age_s"]
    return (
        f"{clock['offset_s']:.6f}",
        f"{clock['drift_ppm']:+.1f}",
        f"{clock['residual_rms_s'] * 1e3:.3f}",
        str(clock["reanchors"]),
        "" if age is None else f"{age:.2f}",
    )


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

    Only streams with a nominal rate are waited for. The agent may still be starting.
    """
    from biosensor_gateway.agent.readiness import wait_until_ready  # it imports asyncio

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
