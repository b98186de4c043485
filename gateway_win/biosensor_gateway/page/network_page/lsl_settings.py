"""Reads from the settings how LSL is configured."""

from __future__ import annotations

from pathlib import Path

from biosensor_gateway.devices.registry import settings_models
from biosensor_gateway.settings import file as settings_file
from biosensor_gateway.settings.models import LslSettings


def lsl_settings(path: Path) -> LslSettings:
    """Read the LSL section of a settings file; the usual one if there is no file.

    Raises
    ------
    ConfigError
        The file is wrong.
    """
    return settings_file.load_or_defaults(path, settings_models()).lsl
