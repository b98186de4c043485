"""``biosensor-gateway status``, ``scan`` and ``test``: what there is, and how it does."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from biosensor_common.errors import (
    ConfigError,
    ConfigReason,
    TransportError,
    TransportReason,
)
from biosensor_common.quantities import Unit
from biosensor_gateway.agent import status_file
from biosensor_gateway.cli.options import JsonOption, SettingsOption, SimulateOption
from biosensor_gateway.cli.screen import console, say, table_of_names
from biosensor_gateway.devices.registry import declaration as spec
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.doctor import device_test
from biosensor_gateway.doctor import scan as search
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.models import (
    DeviceSettings,
    LogSettings,
    settings_path,
    state_folder,
)
from biosensor_gateway.system.logs import configure_logs


def status(as_json: JsonOption = False) -> None:
    """Show what the running agent does; exit code 1 if none runs."""
    try:
        current = status_file.read_status(state_folder())
    except ConfigError as error:
        # The command was right: there is no agent.
        raise TransportError(TransportReason.ABSENT, str(error)) from error
    if as_json:
        typer.echo(json.dumps(current, indent=2))
    else:
        _print_status(current)


def _print_status(current: dict[str, Any]) -> None:
    terminal = console()
    for device in current["devices"]:
        name = " ".join(
            part for part in (device["participant"], device["sensor"], device["label"]) if part
        )
        state = f"paused ({device['state']})" if device["paused"] else device["state"]
        line = f"{name} ({device['unit']}): {state}"
        say(line + (f" - {device['error']}" if device["error"] else ""))
        columns = ("pushed", "lost", "refused", "withheld")
        rows = [
            (source_id, *(str(counters[column]) for column in columns))
            for source_id, counters in device["streams"].items()
        ]
        terminal.print(table_of_names(("stream", *columns), rows, terminal.width))


def scan(
    settings: SettingsOption = None,
    seconds: Annotated[float, typer.Option(min=1, help="How long to listen to Bluetooth.")] = 6.0,
    simulate: SimulateOption = "",
    as_json: JsonOption = False,
) -> None:
    """List the devices in reach, each with the lines that add it to the settings."""
    configure_logs(LogSettings(level="error"), None)
    with _devices(settings, simulate) as configured:
        sections = asyncio.run(search.scan(seconds, configured))
    if as_json:
        typer.echo(json.dumps(search.as_json(sections), indent=2))
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
        if section.others:
            say(f"  not known to any driver: {', '.join(section.others)}", hang=4)
        typer.echo()


def _counted(count: int) -> str:
    return "nothing that a driver knows" if not count else f"{count} found"


def test(
    sensor: Annotated[str, typer.Argument(help="Which sensor, as in polar_h10.")],
    unit: Annotated[str, typer.Option(help="Which one, if several are configured.")] = "",
    settings: SettingsOption = None,
    seconds: Annotated[float, typer.Option(min=1, help="How long to listen.")] = 10.0,
    simulate: Annotated[bool, typer.Option("--simulate", help="Try its virtual twin.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Connect to one device, show what it sends and what is wrong; nothing is streamed."""
    configure_logs(LogSettings(level="error"), None)
    with _devices(settings, sensor if simulate else "") as configured:
        device = device_test.chosen_device(sensor, unit, configured)
        outcome = asyncio.run(device_test.try_device(device, seconds))
    if as_json:
        typer.echo(json.dumps(device_test.as_json(outcome), indent=2))
    else:
        _print_trial(outcome, sensor)
    if outcome.problems:
        raise typer.Exit(1)


def _print_trial(outcome: device_test.Trial, sensor: str) -> None:
    info = outcome.info
    if info is not None:
        details = (info.manufacturer, info.model, info.serial_number, info.firmware_version)
        say(f"connected: {' '.join(each for each in details if each) or 'no details'}")
        console().print(_trial_table(outcome, sensor))
    for problem in outcome.problems:
        say(f"! {problem}")
    if not outcome.problems:
        typer.echo("no problem found")


def _trial_table(outcome: device_test.Trial, sensor: str) -> Table:
    table = Table(box=None)
    table.add_column("stream", no_wrap=True)
    for heading in ("samples", "Hz", "nominal Hz"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("last")
    for name, noted in outcome.streams.items():
        rate = "" if noted.measured_hz is None else f"{noted.measured_hz:.1f}"
        nominal = f"{noted.nominal_hz:g}" if noted.nominal_hz else "irregular"
        channels = spec(sensor).stream(name).channels
        units = ["" if each.unit == Unit.NONE else each.unit for each in channels]
        last = escape(_short(noted.last, units))
        table.add_row(name, str(noted.samples), rate, nominal, last)
    return table


def _short(values: tuple[float | str, ...], units: Sequence[str]) -> str:
    """Return the first values with their units; a unit that all share stands once."""
    shown = [value if isinstance(value, str) else f"{value:.3g}" for value in values[:6]]
    more = " ..." if len(values) > len(shown) else ""
    if len(set(units)) == 1:
        return f"{' '.join(shown)}{more} {units[0]}".rstrip()
    both = zip(shown, units, strict=False)
    return ", ".join(f"{value} {unit}".rstrip() for value, unit in both) + more


@contextmanager
def _devices(settings: Path | None, simulate: str) -> Generator[tuple[DeviceSettings, ...]]:
    """Yield the devices of the settings, or virtual ones while the context lasts."""
    if simulate:
        from biosensor_gateway.demo.virtual_devices import simulated_settings  # noqa: PLC0415 - only on request

        with simulated_settings(simulate.split(",")) as loaded:
            yield loaded.devices
        return
    try:
        loaded = settings_file.load_settings(settings or settings_path(), settings_models())
    except ConfigError as error:
        # To look around one needs no settings yet; a broken file is another matter.
        if settings is not None or error.reason is not ConfigReason.NOT_FOUND:
            raise
        yield ()
    else:
        yield loaded.devices
