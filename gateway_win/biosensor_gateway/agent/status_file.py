"""Writes and reads the file with the agent's status, for ``status`` and for scripts."""

from __future__ import annotations

import contextlib
import json
import time
from pathlib import Path
from typing import Any

import structlog

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.system import state_file

STATUS_FILE = "status.json"
STALE_AFTER_S = 5.0
UNWRITTEN_REPORTS = 3
"""After so many in a row that were refused, the log says so."""

_log = structlog.get_logger("biosensor_gateway.agent")


def write_status(folder: Path, status: dict[str, Any]) -> None:
    """Replace the status file.

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    state_file.replace(folder / STATUS_FILE, json.dumps(status, indent=1))


class StatusWriter:
    """Writes the status of devices, and says in the log once that it cannot.

    Parameters
    ----------
    folder
        Where the file goes.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._refused = 0
        self._said = False

    def write(self, status: dict[str, Any]) -> None:
        """Replace the file; what cannot be written now is written with the next report."""
        try:
            write_status(self._folder, status)
            self._refused = 0
        except OSError as error:
            self._refused += 1
            # Windows refuses while somebody reads it, and a second later does not.
            patience = UNWRITTEN_REPORTS if isinstance(error, PermissionError) else 1
            if not self._said and self._refused >= patience:
                self._said = True
                _log.warning(
                    "the status file cannot be written; `status` will not work", error=str(error)
                )


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


def running_status(folder: Path) -> dict[str, Any]:
    """Read what the running agent wrote last; one that was killed does not run.

    Raises
    ------
    ConfigError
        As `read_status`; ``NOT_FOUND`` also at once after the agent's process has gone.
    """
    status = read_status(folder)
    # An agent may run without the lock, and in a container its number says nothing here.
    if not _lives(status.get("process")) and not is_held(folder):
        message = (
            "the agent has ended without a word, as if it had been killed; start it with: "
            "biosensor-gateway run"
        )
        raise ConfigError(ConfigReason.NOT_FOUND, message)
    return status


def _lives(process: object) -> bool:
    import psutil  # noqa: PLC0415 - only commands ask

    try:
        return psutil.Process(int(str(process))).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
    except (psutil.Error, ValueError, OverflowError):
        return True


def remove_status(folder: Path) -> None:
    """Say that the agent has ended; a file that cannot be removed says so by its age."""
    with contextlib.suppress(OSError):
        (folder / STATUS_FILE).unlink()
