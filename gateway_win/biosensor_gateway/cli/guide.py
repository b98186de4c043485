"""Guides a person at the terminal to a first stream: search, choose, save, test, or simulate."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path

import typer

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.cli.devices import print_outcome
from biosensor_gateway.cli.output import can_ask, menu, say, several
from biosensor_gateway.devices.driver import Found
from biosensor_gateway.devices.registry import sensor_title, settings_models
from biosensor_gateway.doctor import scan as search
from biosensor_gateway.doctor.device_test import run_device_test
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.editor import add_device
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings

SEARCH_S, TEST_S = 6.0, 5.0

_SEARCH = "Look for sensors near this computer"
_VIRTUAL = "Try it with virtual sensors; nothing is needed"
_END = "End"


def is_wanted(path: Path) -> bool:
    """Whether a person is at the terminal, and the settings name no device yet."""
    if not can_ask():
        return False
    try:
        return not _load(path).devices
    except ConfigError as error:
        return error.reason is ConfigReason.NOT_FOUND


def lead(path: Path) -> str:
    """Ask until there is something to stream.

    Parameters
    ----------
    path
        The settings file, which need not exist.

    Returns
    -------
    str
        Comma-separated names of virtual devices; empty for the devices of the settings.

    Raises
    ------
    typer.Exit
        If the person ends the program, or nobody answers.
    ConfigError
        If the settings are wrong, or cannot be written.
    """
    devices = _devices(path)
    while True:
        choices: list[tuple[str, Callable[[], str | None]]] = [
            (_SEARCH, lambda: _set_up(path)),
            (_VIRTUAL, _virtual),
            (_END, _end),
        ]
        if any(each.enabled for each in devices):
            names = ", ".join(_title(each) for each in devices if each.enabled)
            choices.insert(0, (f"Stream what the settings name: {names}", lambda: ""))
            question = "Biosensor Gateway. What is to be done?"
        else:
            question = f"Biosensor Gateway. No sensor is set up yet (settings: {path})."
        chosen = menu(question, [text for text, _ in choices])
        outcome = choices[chosen][1]()
        if outcome is not None:
            return outcome
        devices = _devices(path)


def _load(path: Path) -> GatewaySettings:
    return settings_file.load_settings(path, settings_models())


def _devices(path: Path) -> tuple[DeviceSettings, ...]:
    try:
        return _load(path).devices
    except ConfigError as error:
        if error.reason is not ConfigReason.NOT_FOUND:
            raise
        return ()


def _end() -> str | None:
    raise typer.Exit


def _virtual() -> str | None:
    from biosensor_gateway.demo.virtual_devices import one_of_each  # only on request

    names = one_of_each()
    typer.echo()
    say("These virtual sensors send signals that are made up or were recorded:")
    prompt = "Which? Numbers with blanks between, Enter for all:"
    chosen = several([sensor_title(name) for name in names], prompt, range(len(names)))
    return ",".join(names[index] for index in chosen)


def _set_up(path: Path) -> str | None:
    """Search, and write the chosen devices into the settings; None if none is chosen."""
    found = _found(_devices(path))
    if not found:
        return None
    typer.echo()
    say("Found:")
    prompt = "Which are yours? Numbers with blanks between, Enter to go back:"
    chosen = several([_described(each) for each in found], prompt, ())
    if not chosen:
        return None
    for index in chosen:
        each = found[index]
        add_device(path, settings_models(), each.sensor, each.settings)
        say(f"{_named(found[index])} is in the settings now: {path}")
    units = {(found[index].sensor, found[index].settings["unit"]) for index in chosen}
    return _tested([each for each in _devices(path) if (each.sensor, each.unit) in units])


def _found(configured: Sequence[DeviceSettings]) -> list[Found]:
    typer.echo()
    say(
        f"Looking for sensors for {SEARCH_S:g} seconds: by Bluetooth, at serial ports, at "
        "vendors' programs. Put yours on, or switch them on ..."
    )
    sections = asyncio.run(search.scan(SEARCH_S, configured))
    problems = [f"{each.title}: {each.problem}" for each in sections if each.problem]
    if problems:
        say("It was not possible to look here; if you have no such sensor, that does not matter:")
    for problem in problems:
        say(f"  {problem}", hang=4)
    known = {(each.sensor, each.unit) for each in configured}
    every = [found for section in sections for found in section.found]
    new = [each for each in every if (each.sensor, each.settings.get("unit")) not in known]
    if not new:
        besides = " but what the settings have already" if every else ""
        say(f"No sensor was found{besides}. Is it charged, switched on, near, and worn?")
    return new


def _named(found: Found) -> str:
    title = sensor_title(found.sensor)
    return found.name if found.name.startswith(title) else f"{title}: {found.name}"


def _described(found: Found) -> str:
    signal = "" if found.rssi_dbm is None else f", signal {found.rssi_dbm} dBm"
    return f"{_named(found)}{signal}"


def _title(device: DeviceSettings) -> str:
    parts = (device.participant, sensor_title(device.sensor), device.label or device.unit)
    return " ".join(part for part in parts if part)


def _tested(devices: Sequence[DeviceSettings]) -> str | None:
    for device in devices:
        while not _passes(device):
            choices = ["Test it again", "Stream all the same", "Go back"]
            chosen = menu(f"{_title(device)}: the test found what stands above.", choices)
            if chosen == choices.index("Stream all the same"):
                break
            if chosen == choices.index("Go back"):
                return None
    return ""


def _passes(device: DeviceSettings) -> bool:
    typer.echo()
    say(f"{_title(device)}: connecting, then listening for {TEST_S:g} seconds ...")
    outcome = asyncio.run(run_device_test(device, TEST_S))
    print_outcome(outcome)
    return not outcome.problems
