"""Loads the settings for commands that do without a settings file."""

from __future__ import annotations

from pathlib import Path

from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.models import GatewaySettings
from biosensor_gateway.settings.places import settings_path


def settings_or_defaults(path: Path | None) -> GatewaySettings:
    """Load a settings file, or the usual one if there is one.

    Raises
    ------
    ConfigError
        If the file is wrong, or the named one is not there.
    """
    if path is not None:
        return settings_file.load_settings(path, settings_models())
    return settings_file.load_or_defaults(settings_path(), settings_models())
