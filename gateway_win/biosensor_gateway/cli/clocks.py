"""``biosensor-gateway clocks``: how the devices' clocks stand against LSL's."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Mapping
from typing import Annotated, Any

import typer
from rich.console import Group
from rich.live import Live
from rich.table import Table

from biosensor_common.errors import ConfigError, TransportError, TransportReason
from biosensor_gateway.agent import status_file
from biosensor_gateway.cli.options import JsonOption
from biosensor_gateway.cli.screen import console, table_of_names
from biosensor_gateway.settings.places import state_folder

_EVERY_S = 1.0
_HEADINGS = ("device", "offset s", "drift ppm", "RMS ms", "jumps", "age s")


def clocks(
    watch: Annotated[
        bool, typer.Option("--watch", help="Print again every second, until Ctrl-C.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Show how the devices' clocks are mapped to LSL's; exit code 1 if no agent runs.

    Offset: LSL time minus device time. Drift: how many microseconds a device's second is
    short of one of LSL's. RMS: how far the best packets are off the line. Jumps: how often
    the mapping began anew. Age: since the newest sample was measured. None: the device has
    no clock of its own, or nothing came from it yet.
    """
    # Ctrl-C is how watching ends; it is no failure.
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
        # The command was right: there is no agent.
        raise TransportError(TransportReason.ABSENT, str(error)) from error


def _print_json(*, watch: bool) -> None:
    while True:
        # While watching, one line is one report, as a reader of lines wants it.
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
    """Take what concerns the clocks out of an agent's status.

    Returns
    -------
    dict
        ``written`` (unix time, s) and ``clocks``, one a device: who it is, its state,
        and ``clock``, which is None while the device has none.
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
