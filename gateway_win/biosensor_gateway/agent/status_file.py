"""Writes the agent's status once a second, for ``status`` and for scripts, and reads it."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pylsl import local_clock

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.agent.device import Device
from biosensor_gateway.system import state_file
from biosensor_gateway.system.keep_alive import restart_facts

STATUS_FILE = "status.json"
STALE_AFTER_S = 5.0


def snapshot(devices: Iterable[Device]) -> dict[str, Any]:
    """Describe the agent and every device of it."""
    return {
        "written": time.time(),
        # On which the clocks' `newest_s` and the streams' `last_stamp` are.
        "lsl_time": local_clock(),
        "process": os.getpid(),
        **restart_facts(os.environ),
        "devices": [device.status() for device in devices],
    }


def write_status(folder: Path, status: dict[str, Any]) -> None:
    """Replace the status file.

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    state_file.replace(folder / STATUS_FILE, json.dumps(status, indent=1))


def read_status(folder: Path) -> dict[str, Any]:
    """Read what a running agent wrote last.

    Raises
    ------
    ConfigError
        ``NOT_FOUND`` if no agent runs, ``UNREADABLE`` if its file is damaged.
    """
    path = folder / STATUS_FILE
    try:
        status: dict[str, Any] = json.loads(state_file.read(path))
        age = time.time() - float(status["written"])
        status["devices"] = list(status["devices"])
    except FileNotFoundError as error:
        message = "no agent is running; start one with: biosensor-gateway run"
        raise ConfigError(ConfigReason.NOT_FOUND, message) from error
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        message = f"{path}: the status file cannot be read ({error}); restart the agent"
        raise ConfigError(ConfigReason.UNREADABLE, message) from error
    if age > STALE_AFTER_S:
        message = f"the agent last reported {age:.0f} s ago; start it with: biosensor-gateway run"
        raise ConfigError(ConfigReason.NOT_FOUND, message)
    return status


def remove_status(folder: Path) -> None:
    """Say that the agent has ended; a file that cannot be removed says so by its age."""
    with contextlib.suppress(OSError):
        (folder / STATUS_FILE).unlink()
