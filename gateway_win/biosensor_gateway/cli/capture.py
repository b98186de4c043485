"""``biosensor-gateway capture``: saves what a real device sends, to improve its driver."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from biosensor_common.errors import ConfigError, ConfigReason, SpecError
from biosensor_gateway.cli.app import QuickGroup
from biosensor_gateway.cli.options import (
    JsonOption,
    SettingsOption,
    chosen_devices,
    refuse_if_streamed,
    settings_or_defaults,
)
from biosensor_gateway.cli.output import ask, can_ask, console, say, table_of_names
from biosensor_gateway.settings.models import LogSettings
from biosensor_gateway.system.logs import configure_logs

if TYPE_CHECKING:
    from typer._click import Command, Context

    from biosensor_gateway.captures.draft import Draft
    from biosensor_gateway.captures.file import Capture
    from biosensor_gateway.captures.replay import Report


class _Captures(QuickGroup):
    """A group that takes an unknown command for the name of a sensor to capture."""

    default = "of"

    def resolve_command(
        self, ctx: Context, args: list[str]
    ) -> tuple[str | None, Command | None, list[str]]:
        if args and args[0] not in self.commands and not args[0].startswith("-"):
            args = [self.default, *args]
        return super().resolve_command(ctx, args)


app = typer.Typer(cls=_Captures, no_args_is_help=True)


@app.callback()
def _group() -> None:
    """Capture what a device sends, to help its driver: capture SENSOR. Or replay a capture."""


@app.command(_Captures.default)
def capture_of(
    sensor: Annotated[str, typer.Argument(help="Which sensor, by its name in the settings.")],
    unit: Annotated[str, typer.Option(help="Which one, if several are configured.")] = "",
    settings: SettingsOption = None,
    seconds: Annotated[float, typer.Option(min=5, max=3600, help="How long.")] = 60.0,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE", help="File to write.", show_default=False)
    ] = None,
    simulate: Annotated[bool, typer.Option("--simulate", help="Try its virtual device.")] = False,
) -> None:
    """Capture a device: `capture SENSOR` does the same. Nothing is sent.

    All data between its driver and the device is kept with its times of arrival. Addresses,
    serial numbers and names are replaced. You see what the file holds, and it is saved only if
    you agree.
    """
    if not can_ask():
        message = "a capture needs a person's consent: run it in a terminal"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    # takes a second, needs liblsl
    from biosensor_gateway.captures.draft import HOW_TO_SEND, Draft, refuse_place
    from biosensor_gateway.captures.recorder import take
    from biosensor_gateway.doctor.device_test import chosen_device

    configure_logs(LogSettings(level="error"), None)
    refuse_place(output or Path())
    try:
        with chosen_devices(settings, sensor if simulate else "") as configured:
            device = chosen_device(sensor, unit, configured)
            if not simulate:
                refuse_if_streamed(device)
            say(f"Connecting, then {seconds:g} s are captured. The device should be worn.")
            taken = asyncio.run(take(device, seconds))
        draft = Draft(taken, "a virtual device" if simulate else "")
        typer.echo()
        for line in draft.lines:
            say(line, hang=4)
        for problem in draft.problems:
            say(f"! {problem}")
        path = _saved(draft, output or Path()) if _is_agreed(draft) else None
    except KeyboardInterrupt:
        say("Nothing was saved.")
        raise
    if path is None:
        say("Nothing was saved.")
        raise typer.Exit(1)
    say(f"Saved: {path} ({path.stat().st_size / 1024:.0f} KB). Nothing was sent.")
    say(HOW_TO_SEND)


@app.command()
def replay(
    files: Annotated[
        list[Path], typer.Argument(help="Captures, or folders of them.", show_default=False)
    ],
    live: Annotated[
        bool, typer.Option("--live", help="At its original speed, as LSL streams.")
    ] = False,
    settings: SettingsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run captures through their drivers, at once or live; exit code 1 if one has a problem.

    The report says what was decoded, dropped and refused, and by how much the
    stamps are before the arrivals. With --live, the LSL section of the settings holds.
    """
    from biosensor_gateway.captures.file import read  # only then, as above
    from biosensor_gateway.captures.replay import replay as replayed

    configure_logs(LogSettings(level="error"), None)
    if live:
        from biosensor_gateway.captures.replay import live_outlets

        live_outlets(settings_or_defaults(settings).lsl.overrides)
    reports: dict[str, Report] = {}
    for path in _each(files):
        capture = read(path)
        try:
            report = reports[str(path)] = replayed(capture, live=live)
        except (ConfigError, SpecError) as error:
            raise ConfigError(ConfigReason.MALFORMED, f"{path}: {error}") from error
        if not as_json:
            _print(path, capture, report)
    if as_json:
        typer.echo(json.dumps({path: _plain(each) for path, each in reports.items()}, indent=2))
    if any(each.problems for each in reports.values()):
        raise typer.Exit(1)


def _is_agreed(draft: Draft) -> bool:
    from biosensor_gateway.captures.draft import CONSENT  # only then, as above

    typer.echo()
    say(CONSENT)
    typer.echo()
    while True:
        answer = ask("Type yes to save it, show to see all of it, no to throw it away:", str)
        # What is mistyped neither agrees nor throws away.
        if answer.casefold() in ("yes", "no"):
            return answer.casefold() == "yes"
        for line in draft.whole() if answer.casefold() == "show" else ():
            typer.echo(line)


def _saved(draft: Draft, path: Path) -> Path | None:
    """Ask for a note and save; where that fails, ask for another place. None if there is none."""
    note = ask("What did you see? One line without names, or Enter:", str)
    while True:
        try:
            return draft.save(path, note)
        except ConfigError as error:
            say(f"! {error}")
        answer = ask("Where instead? A file or a folder, or Enter to throw it away:", str)
        if not answer:
            return None
        path = Path(answer).expanduser()


def _each(files: Sequence[Path]) -> Iterator[Path]:
    from biosensor_gateway.captures.file import ENDING  # only then

    for path in files:
        if path.is_dir():
            found = sorted(path.rglob(f"*{ENDING}"))
            if not found:
                message = f"there is no capture, no file *{ENDING}, in {path}; name another folder"
                raise ConfigError(ConfigReason.NOT_FOUND, message)
            yield from found
        else:
            yield path


def _print(path: Path, capture: Capture, report: Report) -> None:
    header = capture.header
    known = " ".join(filter(None, (header.sensor, header.model, header.firmware)))
    say(f"{path}: {known}; {report.connections} connections in {report.seconds:.1f} s")
    rows = [
        (
            name,
            str(each.samples),
            str(each.lost),
            str(each.refused),
            *map(_milliseconds, (each.least_s, each.median_s, each.most_s)),
        )
        for name, each in report.streams.items()
    ]
    if rows:
        headings = ("stream", "samples", "lost", "refused", "least ms", "median ms", "most ms")
        terminal = console()
        terminal.print(table_of_names(headings, rows, terminal.width))
        if any(each.ages_s for each in report.streams.values()):
            say("ms: from the stamp of a packet's last sample to its arrival.")
    if report.reanchors:
        say(
            f"! the device's clock jumped {report.reanchors} times; its timestamps were re-anchored"
        )
    for sentence in (*report.sentences, *report.problems, *report.notes):
        say(f"! {sentence}")
    if not (report.sentences or report.problems or report.notes or report.reanchors):
        say("no problem found")


def _milliseconds(seconds: float | None) -> str:
    return "" if seconds is None else f"{1000 * seconds:.1f}"


def _plain(report: Report) -> dict[str, object]:
    plain = asdict(report)
    for name, each in report.streams.items():
        ages = {"least_s": each.least_s, "median_s": each.median_s, "most_s": each.most_s}
        counts = {"samples": each.samples, "lost": each.lost, "refused": each.refused}
        plain["streams"][name] = counts | ages
    return plain
