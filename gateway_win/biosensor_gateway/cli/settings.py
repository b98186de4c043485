"""Loads the settings for commands: from a file, the defaults, or for virtual devices."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings
from biosensor_gateway.settings.places import settings_path


def settings_or_defaults(path: Path | None) -> GatewaySettings:
    """Load the given settings file, else the default file, else the default settings.

    Raises
    ------
    ConfigError
        If the file is wrong, or the given one does not exist.
    """
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
    try:
        loaded = settings_file.load_settings(settings or settings_path(), settings_models())
    except ConfigError as error:
        # Commands that only look need no settings; a broken file is reported all the same.
        if settings is not None or error.reason is not ConfigReason.NOT_FOUND:
            raise
        yield ()
    else:
        yield loaded.devices
