"""The commands, put together.

Exit codes: 0 done, 1 something is missing or did not work, 2 the command or
the settings are wrong.
"""

from __future__ import annotations

import sys
from importlib.metadata import version
from typing import Annotated

import typer

from biosensor_common.errors import ConfigError, GatewayError
from biosensor_gateway.cli import (
    clocks,
    doctor,
    installation,
    looking,
    readiness,
    record,
    running,
    secrets,
    settings,
    withdrawal,
    xdf,
)

EXIT_FAILED, EXIT_USAGE = 1, 2

app = typer.Typer(
    help="Wearable biosensors as Lab Streaming Layer outlets.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command()(running.run)
app.command()(running.stop)
app.command()(withdrawal.pause)
app.command()(withdrawal.resume)
app.command()(running.demo)
app.command()(looking.status)
app.command()(clocks.clocks)
app.command("wait-ready")(readiness.wait_ready)
app.command()(looking.scan)
app.command("test")(looking.test)
app.command()(doctor.doctor)
app.command("doctor-probe", hidden=True)(doctor.doctor_probe)
app.add_typer(settings.app, name="config")
app.add_typer(secrets.app, name="secrets")
app.add_typer(record.app, name="record")
app.add_typer(xdf.app, name="xdf")
app.add_typer(installation.app, name="installation", hidden=True)


def main() -> None:
    """Run the command line; every expected failure is one sentence on stderr."""
    try:
        app()
    except ConfigError as error:
        _fail(error, EXIT_USAGE)
    except GatewayError as error:
        _fail(error, EXIT_FAILED)


def _fail(error: GatewayError, code: int) -> None:
    sys.stderr.write(f"biosensor-gateway: {error}\n")
    raise SystemExit(code)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"biosensor-gateway {version('biosensor-gateway')}")
        raise typer.Exit


@app.callback()
def _root(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    pass
