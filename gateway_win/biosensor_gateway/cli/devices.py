"""Commands that look at devices without an agent: ``scan``, ``test``, and the guide of ``run``."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.quantities import Unit
from biosensor_gateway.cli.options import (
    JsonOption,
    SettingsOption,
    SimulateOption,
    chosen_devices,
    refuse_if_streamed,
)
from biosensor_gateway.cli.output import can_ask, console, menu, say, several
from biosensor_gateway.devices.registry import sensor_title, settings_models
from biosensor_gateway.doctor import scan as search
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.editor import add_device
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings, LogSettings
from biosensor_gateway.system.logs import configure_logs

if TYPE_CHECKING:
    from biosensor_gateway.doctor.device_test import DeviceTest


def test(
    sensor: Annotated[str, typer.Argument(help="Which sensor, by its name in the settings.")],
    unit: Annotated[str, typer.Option(help="Which one, if several are configured.")] = "",
    settings: SettingsOption = None,
    seconds: Annotated[float, typer.Option(min=1, help="How long to listen.")] = 10.0,
    simulate: Annotated[bool, typer.Option("--simulate", help="Try its virtual device.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Connect to one device, show what it sends and what is wrong; nothing is streamed."""
    from biosensor_gateway.doctor import device_test  # takes a second, and needs liblsl

    configure_logs(LogSettings(level="error"), None)
    with chosen_devices(settings, sensor if simulate else "") as configured:
        device = device_test.chosen_device(sensor, unit, configured)
        if not simulate:
            refuse_if_streamed(device)
        outcome = asyncio.run(device_test.run_device_test(device, seconds))
    if as_json:
        typer.echo(json.dumps(device_test.described(outcome).model_dump(), indent=2))
    else:
        print_outcome(outcome)
    if outcome.problems:
        raise typer.Exit(1)


def print_outcome(outcome: DeviceTest) -> None:
    """Print the outcome of a device test."""
    info = outcome.info
    if info is not None:
        details = (info.manufacturer, info.model, info.serial_number, info.firmware_version)
        say(f"connected: {' '.join(each for each in details if each) or 'no details'}")
        console().print(_table(outcome))
    for problem in outcome.problems:
        say(f"! {problem}")
    if not outcome.problems:
        typer.echo("no problem found")


def _table(outcome: DeviceTest) -> Table:
    table = Table(box=None)
    table.add_column("stream", no_wrap=True)
    for heading in ("samples", "Hz", "nominal Hz"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("last")
    for name, noted in outcome.streams.items():
        rate = "" if noted.measured_hz is None else f"{noted.measured_hz:.1f}"
        nominal = f"{noted.nominal_hz:g}" if noted.nominal_hz else "irregular"
        units = ["" if each == Unit.NONE else each for each in noted.units]
        last = escape(_short(noted.last, units))
        table.add_row(name, str(noted.samples), rate, nominal, last)
    return table


def _short(values: tuple[float | str, ...], units: Sequence[str]) -> str:
    """Return the first values with their units; a unit that all share is written once."""
    shown = [value if isinstance(value, str) else f"{value:.3g}" for value in values[:6]]
    more = " ..." if len(values) > len(shown) else ""
    if len(set(units)) == 1:
        return f"{' '.join(shown)}{more} {units[0]}".rstrip()
    both = zip(shown, units, strict=False)
    return ", ".join(f"{value} {unit}".rstrip() for value, unit in both) + more


def scan(
    settings: SettingsOption = None,
    seconds: Annotated[float, typer.Option(min=1, help="How long to listen to Bluetooth.")] = 6.0,
    simulate: SimulateOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the devices in reach, each with the lines that add it to the settings."""
    configure_logs(LogSettings(level="error"), None)
    with chosen_devices(settings, ",".join(simulate or ())) as configured:
        places = asyncio.run(search.scan(seconds, configured))
    if as_json:
        typer.echo(json.dumps([each.model_dump() for each in places], indent=2))
    else:
        _print_places(places)


def _print_places(places: list[search.SearchedPlace]) -> None:
    for place in places:
        say(f"{place.where}: {place.problem or _counted(len(place.found))}")
        for found in place.found:
            signal = "" if found.rssi_dbm is None else f", {found.rssi_dbm} dBm"
            typer.echo()
            say(f"  {found.name}{signal}", hang=4)
            typer.echo()
            typer.echo("\n".join(f"    {line}" for line in found.toml.splitlines()))
        for sentence in place.advice:
            typer.echo()
            say(f"  {sentence}", hang=2)
        if place.others:
            say(f"  not known to any driver: {', '.join(place.others)}", hang=4)
        typer.echo()


def _counted(count: int) -> str:
    return "nothing that any driver knows" if not count else f"{count} found"


SEARCH_S, TEST_S = 6.0, 5.0
_SEARCH = "Look for sensors near this computer"
_VIRTUAL = "Try it with virtual sensors; no hardware is needed"
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
            question = "Biosensor Gateway. What do you want to do?"
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
    say("These virtual sensors send synthetic or recorded signals:")
    prompt = "Which ones? Numbers separated by spaces, Enter for all:"
    chosen = several([sensor_title(name) for name in names], prompt, range(len(names)))
    return ",".join(names[index] for index in chosen)


def _set_up(path: Path) -> str | None:
    """Search, and write the chosen devices into the settings; None if none is chosen."""
    found = _found(_devices(path))
    if not found:
        return None
    typer.echo()
    say("Found:")
    prompt = "Which are yours? Numbers separated by spaces, Enter to go back:"
    chosen = several([_described(each) for each in found], prompt, ())
    if not chosen:
        return None
    for index in chosen:
        each = found[index]
        add_device(path, settings_models(), each.sensor, each.settings)
        say(f"{_named(found[index])} is in the settings now: {path}")
    units = {(found[index].sensor, found[index].settings["unit"]) for index in chosen}
    return _tested([each for each in _devices(path) if (each.sensor, each.unit) in units])


def _found(configured: Sequence[DeviceSettings]) -> list[search.FoundDevice]:
    typer.echo()
    say(
        f"Looking for sensors for {SEARCH_S:g} seconds: by Bluetooth, at serial ports, in "
        "vendors' programs. Put yours on, or switch them on ..."
    )
    places = asyncio.run(search.scan(SEARCH_S, configured))
    problems = [f"{each.where}: {each.problem}" for each in places if each.problem]
    if problems:
        say("These places could not be searched; if you have no such sensor, that does not matter:")
    for problem in problems:
        say(f"  {problem}", hang=4)
    every = [found for place in places for found in place.found]
    new = [each for each in every if not each.is_known]
    if not new:
        besides = " except those already in the settings" if every else ""
        say(f"No sensor was found{besides}. Is it charged, switched on, near, and worn?")
    return new


def _named(found: search.FoundDevice) -> str:
    is_titled = found.name.startswith(found.title)
    return found.name if is_titled else f"{found.title}: {found.name}"


def _described(found: search.FoundDevice) -> str:
    signal = "" if found.rssi_dbm is None else f", signal {found.rssi_dbm} dBm"
    return f"{_named(found)}{signal}"


def _title(device: DeviceSettings) -> str:
    parts = (device.participant, sensor_title(device.sensor), device.label or device.unit)
    return " ".join(part for part in parts if part)


def _tested(devices: Sequence[DeviceSettings]) -> str | None:
    for device in devices:
        while not _passes(device):
            choices = ["Test it again", "Stream anyway", "Go back"]
            chosen = menu(f"{_title(device)}: the test found the problems above.", choices)
            if chosen == choices.index("Stream anyway"):
                break
            if chosen == choices.index("Go back"):
                return None
    return ""


def _passes(device: DeviceSettings) -> bool:
    from biosensor_gateway.doctor import device_test  # takes a second, and needs liblsl

    typer.echo()
    say(f"{_title(device)}: connecting, then listening for {TEST_S:g} seconds ...")
    outcome = asyncio.run(device_test.run_device_test(device, TEST_S))
    print_outcome(outcome)
    return not outcome.problems
