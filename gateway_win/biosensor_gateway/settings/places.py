"""The paths of the settings file and of the state folder."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs

APP_NAME = "biosensor-gateway"
SETTINGS_VARIABLE = "BIOSENSOR_GATEWAY_SETTINGS"
STATE_VARIABLE = "BIOSENSOR_GATEWAY_STATE"


def settings_path() -> Path:
    """Return ``BIOSENSOR_GATEWAY_SETTINGS``, or the settings file in the user's config folder."""
    chosen = os.environ.get(SETTINGS_VARIABLE)
    if chosen:
        return Path(chosen).expanduser()
    return platformdirs.user_config_path(APP_NAME, appauthor=False) / "settings.toml"


def state_folder() -> Path:
    """Return ``BIOSENSOR_GATEWAY_STATE``, or the user's state folder, for status and logs."""
    chosen = os.environ.get(STATE_VARIABLE)
    if chosen:
        return Path(chosen).expanduser()
    return platformdirs.user_state_path(APP_NAME, appauthor=False)
