"""Options and arguments that several commands share, and the settings that they name."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from biosensor_common.errors import ConfigError, ConfigReason

# What loads settings is imported by who loads them: the help of a command needs none of it.
if TYPE_CHECKING:
    from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings

SettingsOption = Annotated[
    Path | None, typer.Option("--settings", help="Settings file instead of the usual one.")
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print JSON.")]
SimulateOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Use these virtual devices instead (comma-separated, or all); with @P01: worn by P01."
    ),
]
FaultOption = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        help="Give the virtual devices a fault: [SENSOR:]KIND[:VALUE]@START, such as drop:5s@10s "
        "(repeatable).",
    ),
]

RecordingArgument = Annotated[Path, typer.Argument(help="The recording.", show_default=False)]

# The part of a recording that a command works on.
StreamsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--streams",
        metavar="PATTERN",
        help="Only streams of this name or source_id; * and ? are wildcards (repeatable).",
    ),
]
ParticipantOption = Annotated[str, typer.Option(help="Only this person's streams.")]
WithoutOption = Annotated[
    str, typer.Option("--without", metavar="PERSON", help="All streams except this person's.")
]
FromOption = Annotated[
    str,
    typer.Option(
        "--from",
        metavar="TIME",
        help="Time since the start, such as 90.5 or 1:30.5, or a date and time.",
    ),
]
UntilOption = Annotated[str, typer.Option("--until", metavar="TIME", help="Likewise.")]


@contextmanager
def wrong_recording() -> Generator[None]:
    """Raise `ConfigError`, for exit code 2, if an argument is not a readable recording or bag."""
    from biosensor_gateway.recording.bag.types import BagError, BagReason  # not needed for help
    from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason

    try:
        yield
    except RecordingError as error:
        # The argument was wrong; exit code 1 is for what is wrong in a recording.
        if error.reason in {
            RecordingReason.NOT_FOUND,
            RecordingReason.UNREADABLE,
            RecordingReason.NOT_XDF,
        }:
            raise ConfigError(ConfigReason.UNREADABLE, str(error)) from error
        raise
    except BagError as error:
        as_config = {
            BagReason.NOT_FOUND: ConfigReason.NOT_FOUND,
            BagReason.UNREADABLE: ConfigReason.UNREADABLE,
            BagReason.NOT_A_BAG: ConfigReason.UNREADABLE,
            BagReason.EXISTS: ConfigReason.EXISTS,
        }
        reason = as_config.get(error.reason) if isinstance(error.reason, BagReason) else None
        if reason is None:
            raise
        raise ConfigError(reason, str(error)) from error


def settings_or_defaults(path: Path | None) -> GatewaySettings:
    """Load the given settings file, else the default file, else the default settings.

    Raises
    ------
    ConfigError
        If the file is wrong, or the given one does not exist.
    """
    from biosensor_gateway.devices.registry import settings_models
    from biosensor_gateway.settings import file as settings_file
    from biosensor_gateway.settings.places import settings_path

    if path is not None:
        return settings_file.load_settings(path, settings_models())
    return settings_file.load_or_defaults(settings_path(), settings_models())


@contextmanager
def chosen_devices(settings: Path | None, simulate: str) -> Generator[tuple[DeviceSettings, ...]]:
    """Yield the devices of the settings, or virtual ones while the context lasts."""
    if simulate:
        from biosensor_gateway.demo.virtual_devices import simulated_settings  # only on request

        with simulated_settings(simulate.split(",")) as loaded:
            yield loaded.devices
        return
    from biosensor_gateway.devices.registry import settings_models
    from biosensor_gateway.settings import file as settings_file
    from biosensor_gateway.settings.places import settings_path

    try:
        loaded = settings_file.load_settings(settings or settings_path(), settings_models())
    except ConfigError as error:
        # Commands that only look need no settings; a broken file is reported all the same.
        if settings is not None or error.reason is not ConfigReason.NOT_FOUND:
            raise
        yield ()
    else:
        yield loaded.devices


def refuse_if_streamed(device: DeviceSettings) -> None:
    """Refuse a device that the running agent streams: at the end it would be told to stop.

    Raises
    ------
    ConfigError
        ``IN_USE``.
    """
    from biosensor_gateway.agent.device_states import State
    from biosensor_gateway.agent.status_file import running_status
    from biosensor_gateway.settings.places import state_folder

    try:
        status = running_status(state_folder())
    except ConfigError:
        # No agent runs, so none has it.
        return
    which = device.sensor_name, device.unit, State.STREAMING.value
    streamed = {(each["sensor"], each["unit"], each["state"]) for each in status["devices"]}
    if which in streamed and not status.get("virtual"):
        message = (
            f"the agent is using {device.sensor_name} {device.unit}, and most devices accept only "
            "one connection; end it with `biosensor-gateway stop`, and start it again afterwards"
        )
        raise ConfigError(ConfigReason.IN_USE, message)
