"""``biosensor-gateway withdraw``: removes one person from recordings and from their exports."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from biosensor_common.errors import ConfigError, ConfigReason, GatewayError, cannot_write
from biosensor_gateway.cli.options import JsonOption
from biosensor_gateway.cli.output import say
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.report_text import printable
from biosensor_gateway.system.shutdown import requests_interrupt

if TYPE_CHECKING:
    from biosensor_gateway.recording.withdrawal.work import Plan, Report


def withdraw(
    participant: Annotated[str, typer.Argument(help="Who withdraws.", show_default=False)],
    places: Annotated[
        list[Path],
        typer.Argument(
            metavar="FOLDER...",
            help="Folders with recordings, exports, bags and notes.",
            show_default=False,
        ),
    ],
    is_confirmed: Annotated[
        bool, typer.Option("--yes", help="Do what the plan says, without asking.")
    ] = False,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write the report to this file, as JSON.", show_default=False
        ),
    ] = None,
    print_json: JsonOption = False,
) -> None:
    """Remove one person from files: show a plan, ask, carry it out, and search what is left.

    Recordings are written again without the person's streams and name; recordings, exports,
    tables, bags and notes of this person alone are deleted. Unclear files are listed and left to
    you. The report has hashes of each file before and after, and the result of a search through
    all files that are left; exit code 1 if something of the person is still found. Deleted files
    cannot be restored: do not copy them first, and remember your backups, which this command
    cannot reach.
    """
    from biosensor_gateway.recording.withdrawal.work import Action, carry_out, plan

    for place in places:
        if not place.exists():
            raise ConfigError(ConfigReason.NOT_FOUND, f"there is no file or folder {place}")
    if report is not None and report.exists():
        message = f"{report} exists and is not overwritten; give another name with --report"
        raise ConfigError(ConfigReason.EXISTS, message)
    found = plan(participant, places)
    if not print_json:
        _say_plan(found)
    to_do = [each for each in found.steps if each.action is not Action.LOOK]
    if to_do and not is_confirmed:
        if print_json:
            typer.echo(json.dumps({"plan": _as_json(found)}, indent=2))
            raise typer.Exit(1)
        typer.confirm("Do it? Deleted data cannot be restored", abort=True)
    if report is not None:
        _require_place(report)
    with requests_interrupt():
        result = carry_out(found)
    content = json.dumps({"plan": _as_json(found), "report": asdict(result)}, indent=2, default=str)
    if print_json:
        typer.echo(content)
    else:
        _say_report(result)
    if report is not None:
        _write(report, content)
    if not result.is_clean:
        raise typer.Exit(1)


def _write(report: Path, content: str) -> None:
    """Write the report file, after the outcome was printed."""
    try:
        report.write_text(content + "\n", "utf-8")
    except OSError as error:
        report.unlink(missing_ok=True)
        raise _unwritable(report, error) from error


def _require_place(report: Path) -> None:
    """Check that the report can be written, before anything is done."""
    try:
        report.touch(exist_ok=False)
        report.unlink()
    except OSError as error:
        raise _unwritable(report, error) from error


def _unwritable(report: Path, error: OSError) -> GatewayError:
    return RecordingError(RecordingReason.UNWRITABLE, cannot_write(report, error))


def _as_json(found: Plan) -> list[dict[str, str]]:
    return [
        {"path": str(each.path), "action": each.action, "why": each.why} for each in found.steps
    ]


def _say_plan(found: Plan) -> None:
    if not found.steps:
        say(f"nothing from {found.person} is in {found.files} files")
    for each in found.steps:
        say(f"{each.action}: {printable(str(each.path))}: {printable(each.why)}", hang=4)


def _say_report(result: Report) -> None:
    for each in result.done:
        if each.error:
            say(f"not done: {printable(str(each.path))}: {printable(each.error)}", hang=4)
        else:
            became = f"is now {each.after[:16]}" if each.after else "is gone"
            say(f"{printable(str(each.path))}: {each.before[:16] or 'new'} {became}", hang=4)
    for each in result.left:
        say(f"still there: {printable(str(each.path))}: {each.what}", hang=4)
    for each in result.looked_at:
        say(f"check it yourself: {printable(str(each.path))}: {printable(each.why)}", hang=4)
    if result.is_clean:
        say(
            f"searched {result.searched} files for the name and for {result.pieces} pieces of the "
            "data: nothing is left"
        )
