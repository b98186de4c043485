"""Lets one agent run for each state folder: two would claim the same devices.

The guard is a lock that the operating system keeps for a process (``flock`` on
POSIX, a locked byte on Windows) and gives back however that process ends, so
a killed agent leaves nothing that a new one could trip over.
"""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from pathlib import Path

from filelock import FileLock, Timeout

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.system import state_file

LOCK_FILE = "agent.lock"
"""Of the agent; another program with a folder of this kind has a name of its own."""

# Who looks whether an agent runs holds the lock for an instant; that is no agent.
_PATIENCE_S = 0.5
_POLL_S = 0.05


@contextlib.contextmanager
def single_instance(folder: Path, lock_file: str = LOCK_FILE) -> Generator[None]:
    """Be the only agent with a state folder while the context lasts.

    Parameters
    ----------
    folder
        The state folder, made if needed.
    lock_file
        Name of the lock there.

    Raises
    ------
    ConfigError
        ``IN_USE`` if another agent runs with the folder; ``UNREADABLE`` if the
        folder cannot be written, which need not keep an agent from running.
    """
    lock = _lock(folder / lock_file)
    try:
        state_file.make_folder(folder)
        lock.acquire(timeout=_PATIENCE_S, poll_interval=_POLL_S)
    except Timeout as error:
        message = (
            f"an agent is already running with the state folder {folder}; look at it with: "
            "biosensor-gateway status, end it with: biosensor-gateway stop"
        )
        raise ConfigError(ConfigReason.IN_USE, message) from error
    except OSError as error:
        message = (
            f"cannot write the lock file in {folder}: {error.strerror or error}; "
            "a second agent would not be noticed, and `stop` will not work"
        )
        raise ConfigError(ConfigReason.UNREADABLE, message) from error
    try:
        yield
    finally:
        _give_back(lock)


def is_held(folder: Path, lock_file: str = LOCK_FILE) -> bool:
    """Whether an agent runs with a state folder."""
    return not wait_until_free(folder, 0.0, lock_file)


def wait_until_free(folder: Path, timeout_s: float, lock_file: str = LOCK_FILE) -> bool:
    """Wait until no agent runs with a state folder; return whether that came in time."""
    try:
        if not (folder / lock_file).exists():
            return True
    except OSError:
        # Nobody has a lock where none can be.
        return True
    lock = _lock(folder / lock_file)
    try:
        lock.acquire(timeout=timeout_s, poll_interval=_POLL_S)
    except Timeout:
        return False
    except OSError:
        # Whoever cannot have the lock here runs without it.
        return True
    _give_back(lock)
    return True


def _lock(path: Path) -> FileLock:
    # The stand-in for file systems without locks would outlive a killed agent.
    return FileLock(path, fallback_to_soft=False)


def _give_back(lock: FileLock) -> None:
    # Removed while it is held: who has the old file open by then and gets its lock finds it
    # without a name, and tries again. Windows forbids it, and there the release removes it.
    with contextlib.suppress(OSError):
        Path(lock.lock_file).unlink()
    lock.release()
