"""Commands that look at devices without an agent: ``scan`` and ``test``."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

from biosensor_common.quantities import Unit
from biosensor_gateway.cli.options import JsonOption, SettingsOption, SimulateOption
from biosensor_gateway.cli.output import console, say
from biosensor_gateway.cli.settings import chosen_devices
from biosensor_gateway.doctor import scan as search
from biosensor_gateway.settings.models import LogSettings
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
    simulate: SimulateOption = "",
    as_json: JsonOption = False,
) -> None:
    """List the devices in reach, each with the lines that add it to the settings."""
    configure_logs(LogSettings(level="error"), None)
    with chosen_devices(settings, simulate) as configured:
        sections = asyncio.run(search.scan(seconds, configured))
    if as_json:
        content = [each.model_dump() for each in search.described(sections, configured)]
        typer.echo(json.dumps(content, indent=2))
    else:
        _print_sections(sections)


def _print_sections(sections: list[search.Section]) -> None:
    for section in sections:
        say(f"{section.title}: {section.problem or _counted(len(section.found))}")
        for found in section.found:
            signal = "" if found.rssi_dbm is None else f", {found.rssi_dbm} dBm"
            typer.echo()
            say(f"  {found.name}{signal}", hang=4)
            typer.echo()
            typer.echo("\n".join(f"    {line}" for line in search.toml_lines(found).splitlines()))
        for sentence in search.advice(section):
            typer.echo()
            say(f"  {sentence}", hang=2)
        if section.others:
            say(f"  not known to any driver: {', '.join(section.others)}", hang=4)
        typer.echo()


def _counted(count: int) -> str:
    return "nothing that a driver knows" if not count else f"{count} found"
