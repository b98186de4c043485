"""The token with which web experiments may send markers, and nothing else."""

from __future__ import annotations

import json
import secrets
from pathlib import Path
from typing import Any, cast

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.system import state_file

KEPT_IN = "web-markers.json"
_BYTES = 24


def experiment_token(folder: Path) -> str:
    """Return the stored token, or create one.

    Parameters
    ----------
    folder
        The state folder, where only its user can read it.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if it can neither be read nor written.
    """
    try:
        written: Any = json.loads(state_file.read(folder / KEPT_IN))
    except FileNotFoundError:
        return new_experiment_token(folder)
    except OSError as error:
        raise _unreadable(folder, error) from error
    except (ValueError, RecursionError):
        written = None
    token = cast("dict[str, Any]", written).get("token") if isinstance(written, dict) else None
    return token if isinstance(token, str) and token else new_experiment_token(folder)


def new_experiment_token(folder: Path) -> str:
    """Replace the token by a new one.

    Raises
    ------
    ConfigError
        ``UNREADABLE`` if it cannot be written.
    """
    token = secrets.token_urlsafe(_BYTES)
    try:
        text = json.dumps({"token": token})
        state_file.replace(folder / KEPT_IN, text, private=True, durable=True)
    except OSError as error:
        raise _unreadable(folder, error) from error
    return token


def _unreadable(folder: Path, error: OSError) -> ConfigError:
    message = f"{folder / KEPT_IN}: {error.strerror or error}; web experiments cannot mark"
    return ConfigError(ConfigReason.UNREADABLE, message)
