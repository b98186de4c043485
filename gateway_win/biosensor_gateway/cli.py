"""The command line: ``biosensor-gateway``.

Exit codes: 0 done, 1 something is missing or did not work, 2 the command or
the settings are wrong.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
import sys
from collections.abc import Callable, Coroutine
from importlib.metadata import version
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import structlog
import typer
from rich.console import Console
from rich.table import Table

from biosensor_common.errors import ConfigError, GatewayError
from biosensor_gateway import demo as demonstration
from biosensor_gateway import health, settings_file, settings_template
from biosensor_gateway.agent import Agent
from biosensor_gateway.devices import settings_models
from biosensor_gateway.logs import configure_logs
from biosensor_gateway.settings import GatewaySettings, settings_path, state_folder

EXIT_FAILED, EXIT_USAGE = 1, 2

app = typer.Typer(
    help="Wearable biosensors as Lab Streaming Layer outlets.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
config_app = typer.Typer(help="The settings file.", no_args_is_help=True)
app.add_typer(config_app, name="config")

_log = structlog.get_logger("biosensor_gateway.cli")

SettingsOption = Annotated[
    Path | None, typer.Option("--settings", help="Settings file instead of the usual one.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]


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


@app.command()
def run(
    settings: SettingsOption = None,
    simulate: Annotated[
        str, typer.Option(help="Run these virtual devices instead (comma-separated, or all).")
    ] = "",
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log every detail.")] = False,
) -> None:
    """Stream all devices of the settings until Ctrl-C."""
    if simulate:
        from biosensor_gateway.simulate import simulated_settings  # noqa: PLC0415 - only on request

        with simulated_settings(simulate.split(",")) as loaded:
            _run_agent(loaded, verbose=verbose)
    else:
        path = settings or settings_path()
        _run_agent(settings_file.load_settings(path, settings_models()), verbose=verbose)


def _run_agent(loaded: GatewaySettings, *, verbose: bool) -> None:
    try:
        configure_logs(loaded.log, state_folder(), verbose=verbose)
    except ConfigError as error:
        # Recording goes on without a log file; it does not go on unsaid.
        configure_logs(loaded.log, None, verbose=verbose)
        _log.warning(str(error))
    if not any(device.enabled for device in loaded.devices):
        _log.warning("no device is enabled in the settings; nothing will be streamed")
    agent = Agent(loaded, state_folder())
    asyncio.run(until_signalled(agent.run))


async def until_signalled(main_task: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Run a coroutine until it ends or SIGINT, SIGTERM or a console's close asks to stop."""
    task = asyncio.create_task(main_task())
    loop = asyncio.get_running_loop()

    def stop() -> None:
        # A second Ctrl-C must not cut short what the first one has begun to close.
        if not task.cancelling():
            task.cancel()

    def stop_from_handler(_number: int, _frame: FrameType | None) -> None:
        loop.call_soon_threadsafe(stop)

    for number in (signal.SIGINT, signal.SIGTERM):
        try:
            loop.add_signal_handler(number, stop)
        except NotImplementedError:
            # Windows: the handler runs between bytecodes of the main thread.
            signal.signal(number, stop_from_handler)
    with contextlib.suppress(asyncio.CancelledError):
        await task


@app.command()
def demo(
    seconds: Annotated[
        float | None,
        typer.Option(min=10, help="End after so many seconds, counted from the first sample."),
    ] = None,
) -> None:
    """Show recorded bytes of a real BioHarness on their way to ROS topics."""
    raise typer.Exit(demonstration.run(seconds))


@app.command()
def status(as_json: JsonOption = False) -> None:
    """Show what the running agent does; exit code 1 if none runs."""
    try:
        current = health.read_status(state_folder())
    except ConfigError as error:
        _fail(error, EXIT_FAILED)
    else:
        if as_json:
            typer.echo(json.dumps(current, indent=2))
        else:
            _print_status(current)


def _print_status(current: dict[str, Any]) -> None:
    console = Console()
    for device in current["devices"]:
        name = " ".join(
            part for part in (device["participant"], device["sensor"], device["label"]) if part
        )
        line = f"{name} ({device['unit']}): {device['state']}"
        console.print(line + (f" - {device['error']}" if device["error"] else ""), markup=False)
        table = Table("stream", "pushed", "lost", "refused", box=None)
        for source_id, counters in device["streams"].items():
            figures = (counters["pushed"], counters["lost"], counters["refused"])
            table.add_row(source_id, *(str(figure) for figure in figures))
        console.print(table)


@config_app.command("path")
def config_path() -> None:
    """Print where the settings file is."""
    typer.echo(settings_path())


@config_app.command("init")
def config_init(settings: SettingsOption = None) -> None:
    """Write a settings file with every setting explained; never overwrites."""
    path = settings or settings_path()
    settings_template.write_template(path, settings_models())
    typer.echo(f"wrote {path}; add your devices there")


@config_app.command("check")
def config_check(settings: SettingsOption = None) -> None:
    """Check the settings file; exit code 2 and every problem with its line if it is wrong."""
    path = settings or settings_path()
    loaded = settings_file.load_settings(path, settings_models())
    typer.echo(f"{path}: {len(loaded.devices)} devices, no problem found")


if __name__ == "__main__":
    main()
