"""Writes and reads the file with the agent's status, for ``status`` and for scripts.

Its content is described in `biosensor_gateway.agent.status`.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.system import restart_notice, state_file
from biosensor_gateway.system.child import lives

if TYPE_CHECKING:
    from biosensor_common.lsl.api_file import LslOverrides

STATUS_FILE = "status.json"
STALE_AFTER_S = 5.0


def write_status(folder: Path, status: dict[str, Any]) -> None:
    """Replace the status file.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    state_file.replace(folder / STATUS_FILE, json.dumps(status, indent=1))


def read_status(folder: Path) -> dict[str, Any]:
    """Read the status of the running agent.

    Raises
    ------
    ConfigError
        ``NOT_FOUND`` if no agent runs, ``UNREADABLE`` if its file is damaged or not written.
    """
    path = folder / STATUS_FILE
    try:
        status: dict[str, Any] = json.loads(state_file.read(path))
        # One from the future was written before the clock was set back, and not since.
        age = abs(time.time() - float(status["written"]))
        status["devices"] = list(status["devices"])
    except (FileNotFoundError, NotADirectoryError) as error:
        if _is_held(folder):
            raise _unwritten(folder, "has not written its status yet") from error
        message = "no agent is running; start one with: biosensor-gateway run"
        raise ConfigError(ConfigReason.NOT_FOUND, message) from error
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else "it is damaged"
        message = f"{path}: the status file cannot be read ({why}); restart the agent"
        raise ConfigError(ConfigReason.UNREADABLE, message) from error
    if age > STALE_AFTER_S:
        if _is_held(folder):
            raise _unwritten(folder, f"has not written its status for {age:.0f} s")
        message = f"the agent last reported {age:.0f} s ago; start it with: biosensor-gateway run"
        raise ConfigError(ConfigReason.NOT_FOUND, message)
    return status


def _unwritten(folder: Path, what: str) -> ConfigError:
    """Return the error for an agent that runs without writing its status."""
    # That it runs is known from its lock, which works even on a full disk.
    message = (
        f"an agent is running, but {what} to {folder}: it is starting or stuck, or the disk is "
        "full; free some space and look again"
    )
    return ConfigError(ConfigReason.UNREADABLE, message)


def running_status(folder: Path) -> dict[str, Any]:
    """Read the status of the running agent, and check that its process still exists.

    Raises
    ------
    ConfigError
        As `read_status`; ``NOT_FOUND`` also right after the agent's process has ended. The message
        says if the agent will be restarted.
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
    # Both are needed: an agent may run without the lock, and the process id of one in a container
    # means nothing here.
    if not lives(status.get("process")) and not _is_held(folder):
        message = (
            "the agent has ended without a message, as if it had been killed; start it with: "
            "biosensor-gateway run"
        )
        raise ConfigError(ConfigReason.NOT_FOUND, message)
    return status


def _is_held(folder: Path) -> bool:
    from biosensor_gateway.agent.single_instance import is_held  # noqa: PLC0415 - brings asyncio

    return is_held(folder)


def other_session(status: Mapping[str, Any], lsl: LslOverrides) -> str:
    """Return a sentence if an agent is in another LSL session than this program, else empty."""
    from biosensor_common.lsl.api_file import config_here, session  # noqa: PLC0415 - not for stop

    agent, own = status.get("session", ""), session(config_here(lsl))
    if agent in {"", own}:
        return ""
    return (
        f"the agent sends in the LSL session {agent}, and the settings now say {own}, so its "
        "streams would not be recorded"
    )


def remove_status(folder: Path) -> None:
    """Remove the file when the agent ends; one that cannot be removed becomes stale by its age."""
    with contextlib.suppress(OSError):
        (folder / STATUS_FILE).unlink()
