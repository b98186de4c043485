"""``biosensor-gateway run`` and ``demo``."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Callable, Coroutine
from types import FrameType
from typing import Annotated, Any

import structlog
import typer

from biosensor_common.errors import ConfigError
from biosensor_gateway import demo as demonstration
from biosensor_gateway import settings_file
from biosensor_gateway.agent import Agent
from biosensor_gateway.cli.options import FaultOption, SettingsOption, SimulateOption
from biosensor_gateway.devices import settings_models
from biosensor_gateway.logs import configure_logs
from biosensor_gateway.settings import GatewaySettings, settings_path, state_folder

_log = structlog.get_logger("biosensor_gateway.cli")


def run(
    settings: SettingsOption = None,
    simulate: SimulateOption = "",
    fault: FaultOption = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log every detail.")] = False,
) -> None:
    """Stream all devices of the settings until Ctrl-C."""
    if simulate:
        from biosensor_gateway.simulate import simulated_settings  # noqa: PLC0415 - only on request

        with simulated_settings(simulate.split(","), fault or ()) as loaded:
            _run_agent(loaded, verbose=verbose)
    elif fault:
        raise typer.BadParameter("only virtual devices can be given faults; add --simulate")
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


def demo(
    seconds: Annotated[
        float | None,
        typer.Option(min=10, help="End after so many seconds, counted from the first sample."),
    ] = None,
) -> None:
    """Show all virtual devices on their way to ROS topics."""
    raise typer.Exit(demonstration.run(seconds))
