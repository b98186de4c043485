"""Writes and reads the file with the agent's status, for ``status`` and for scripts.

What is in it: `biosensor_gateway.agent.status`.
"""

from __future__ import annotations

import contextlib
import json
import time
from pathlib import Path
from typing import Any

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.system import restart_notice, state_file
from biosensor_gateway.system.child import lives

STATUS_FILE = "status.json"
STALE_AFTER_S = 5.0


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
        ``NOT_FOUND`` if no agent runs, ``UNREADABLE`` if its file is damaged or it writes none.
    """
    path = folder / STATUS_FILE
    try:
        status: dict[str, Any] = json.loads(state_file.read(path))
        age = time.time() - float(status["written"])
        status["devices"] = list(status["devices"])
    except FileNotFoundError as error:
        if _is_held(folder):
            raise _unwritten(folder, "has written no status yet") from error
        message = "no agent is running; start one with: biosensor-gateway run"
        raise ConfigError(ConfigReason.NOT_FOUND, message) from error
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        message = f"{path}: the status file cannot be read ({error}); restart the agent"
        raise ConfigError(ConfigReason.UNREADABLE, message) from error
    if age > STALE_AFTER_S:
        if _is_held(folder):
            raise _unwritten(folder, f"has written no status for {age:.0f} s")
        message = f"the agent last reported {age:.0f} s ago; start it with: biosensor-gateway run"
        raise ConfigError(ConfigReason.NOT_FOUND, message)
    return status


def _unwritten(folder: Path, what: str) -> ConfigError:
    """Return what to say of an agent that runs: the lock tells, which needs no room on a disk."""
    message = (
        f"an agent runs, and {what} into {folder}: it is starting or stuck, or the disk is full; "
        "make room on it and look again"
    )
    return ConfigError(ConfigReason.UNREADABLE, message)


def running_status(folder: Path) -> dict[str, Any]:
    """Read what the running agent wrote last; one that was killed does not run.

    Raises
    ------
    ConfigError
        As `read_status`; ``NOT_FOUND`` also at once after the agent's process has gone. It says
        so if the agent is started again in a while.
    """
    try:
        return _status_of_a_process(folder)
    except ConfigError as error:
        notice = restart_notice.read(folder)
        if notice is None:
            raise
        raise ConfigError(ConfigReason.NOT_FOUND, notice.sentence) from error


def _status_of_a_process(folder: Path) -> dict[str, Any]:
    status = read_status(folder)
    # An agent may run without the lock, and in a container its number says nothing here.
    if not lives(status.get("process")) and not _is_held(folder):
        message = (
            "the agent has ended without a word, as if it had been killed; start it with: "
            "biosensor-gateway run"
        )
        raise ConfigError(ConfigReason.NOT_FOUND, message)
    return status


def _is_held(folder: Path) -> bool:
    from biosensor_gateway.agent.single_instance import is_held  # noqa: PLC0415 - brings asyncio

    return is_held(folder)


def remove_status(folder: Path) -> None:
    """Say that the agent has ended; a file that cannot be removed says so by its age."""
    with contextlib.suppress(OSError):
        (folder / STATUS_FILE).unlink()
