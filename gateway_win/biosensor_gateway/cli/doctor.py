"""``biosensor-gateway doctor``: what is wrong on this computer, and how to fix it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from biosensor_common.doctor import network_check
from biosensor_common.doctor.check import AGENT, checks_of
from biosensor_common.doctor.network_check.sides import ANSWER_PORT
from biosensor_common.doctor.report import as_json, as_text, run_checks
from biosensor_common.errors import did_you_mean
from biosensor_common.terminal import columns
from biosensor_gateway.cli.options import JsonOption, SettingsOption
from biosensor_gateway.doctor.context import LAB_RECORDER_PORT, read_context
from biosensor_gateway.settings.models import LogSettings
from biosensor_gateway.settings.places import settings_path, state_folder
from biosensor_gateway.system.logs import configure_logs

_CHECKS = checks_of(AGENT)
_NAMES = ", ".join(check.name for check in _CHECKS)


def _chosen(names: list[str] | None) -> list[str]:
    known = {check.name for check in _CHECKS}
    for name in names or ():
        if name not in known:
            hint = did_you_mean(name, known)
            raise typer.BadParameter(f"there is no check {name!r}{hint}; there are {_NAMES}")
    return names or []


def doctor(
    as_json_: JsonOption = False,
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            metavar="NAME",
            help=f"Run this check only (repeatable): {_NAMES}.",
            callback=_chosen,
        ),
    ] = None,
    settings: SettingsOption = None,
    lab_recorder_port: Annotated[
        int, typer.Option(min=1, max=65535, help="TCP port of LabRecorder's remote control.")
    ] = LAB_RECORDER_PORT,
    answer: Annotated[
        bool,
        typer.Option(
            "--answer", help="Answer another computer's --with once, if it gives the right code."
        ),
    ] = False,
    with_: Annotated[
        str,
        typer.Option(
            "--with", metavar="HOST", help="Test the network to a computer that runs --answer."
        ),
    ] = "",
    code: Annotated[
        str, typer.Option(help="For --with: the code that the other computer shows.")
    ] = "",
    port: Annotated[
        int, typer.Option(min=1024, max=65535, help="TCP port of --answer, and for --with.")
    ] = ANSWER_PORT,
) -> None:
    """Say what is wrong on this computer and how to fix it; exit code 1 if there are errors."""
    configure_logs(LogSettings(level="error"), None)
    if answer or with_:
        _network_check(settings, only, answer, with_, code, port, as_json_)
    if code:
        raise typer.BadParameter("--code needs --with and the other computer")
    context = read_context(
        settings or settings_path(), state_folder(), lab_recorder_port=lab_recorder_port
    )
    report = run_checks([each for each in _CHECKS if not only or each.name in only], context)
    text = as_text(report, sys.stdout.encoding or "ascii", columns(sys.stdout))
    typer.echo(as_json(report) if as_json_ else text)
    if not report.is_good:
        raise typer.Exit(1)


def _network_check(
    settings: Path | None,
    only: list[str] | None,
    answering: bool,
    host: str,
    code: str,
    port: int,
    as_json_: bool,
) -> NoReturn:
    """Run one side of the network check, and exit."""
    if only or (answering and host):
        raise typer.BadParameter("--answer, --with and --only exclude each other")
    context = read_context(settings or settings_path(), state_folder())
    if answering:
        raise typer.Exit(network_check.answer(context, AGENT, port, as_json=as_json_))
    code = code or typer.prompt(f"The code shown on {host}", err=True)
    raise typer.Exit(network_check.ask(context, AGENT, host, port, code, as_json=as_json_))


def doctor_probe() -> None:
    """Run a check's second program; used by doctor itself."""
    from biosensor_common.doctor import lsl_process  # brings pylsl

    lsl_process.main()
