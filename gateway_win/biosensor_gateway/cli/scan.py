"""``biosensor-gateway scan``: the devices in reach."""

from __future__ import annotations

import asyncio
import json
from typing import Annotated

import typer

from biosensor_gateway.cli.chosen_devices import chosen_devices
from biosensor_gateway.cli.options import JsonOption, SettingsOption, SimulateOption
from biosensor_gateway.cli.screen import say
from biosensor_gateway.doctor import scan as search
from biosensor_gateway.settings.models import LogSettings
from biosensor_gateway.system.logs import configure_logs


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
        told = [each.model_dump() for each in search.described(sections, configured)]
        typer.echo(json.dumps(told, indent=2))
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
