"""The folders that the settings file and the state lie in."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs

APP_NAME = "biosensor-gateway"
SETTINGS_VARIABLE = "BIOSENSOR_GATEWAY_SETTINGS"
STATE_VARIABLE = "BIOSENSOR_GATEWAY_STATE"


def settings_path() -> Path:
    """Where the settings file is: ``BIOSENSOR_GATEWAY_SETTINGS`` or the user's config folder."""
    chosen = os.environ.get(SETTINGS_VARIABLE)
    if chosen:
        return Path(chosen).expanduser()
    return platformdirs.user_config_path(APP_NAME, appauthor=False) / "settings.toml"


def state_folder() -> Path:
    """Where status and logs go: ``BIOSENSOR_GATEWAY_STATE`` or the user's state folder."""
    chosen = os.environ.get(STATE_VARIABLE)
    if chosen:
        return Path(chosen).expanduser()
    return platformdirs.user_state_path(APP_NAME, appauthor=False)
