"""Allows one agent per state folder, because two would claim the same devices.

The lock is one that the operating system holds for a process (``flock`` on
POSIX, a locked byte on Windows). It is released however the process ends, so
that a killed agent does not keep a new one from starting.
"""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from pathlib import Path

from filelock import FileLock, Timeout

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.system import state_file

LOCK_FILE = "agent.lock"
"""Lock file of the agent; other programs with such a folder use other names."""

# A program that checks whether an agent runs holds the lock for an instant, so wait a little.
_PATIENCE_S = 0.5
_POLL_S = 0.05


@contextlib.contextmanager
def single_instance(folder: Path, lock_file: str = LOCK_FILE) -> Generator[None]:
    """Hold the lock of a state folder while the context lasts.

    Parameters
    ----------
    folder
        The state folder, created if needed.

    Raises
    ------
    ConfigError
        ``IN_USE`` if another agent runs with the folder; ``UNREADABLE`` if the
        folder cannot be written, in which case an agent can run without the lock.
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
    """Wait until no agent runs with a state folder; return False if one still does."""
    try:
        if not (folder / lock_file).exists():
            return True
    except OSError:
        # A folder that cannot be read has no lock.
        return True
    lock = _lock(folder / lock_file)
    try:
        lock.acquire(timeout=timeout_s, poll_interval=_POLL_S)
    except Timeout:
        return False
    except OSError:
        # An agent that cannot lock a read-only folder runs without the lock.
        return True
    _give_back(lock)
    return True


def _lock(path: Path) -> FileLock:
    # A soft lock, for file systems without locks, would stay behind after a killed agent.
    return FileLock(path, fallback_to_soft=False)


def _give_back(lock: FileLock) -> None:
    # Unlink while the lock is held: a process that has the old file open and then gets its lock
    # sees that it has no name any more, and tries again. Windows forbids this, and there the
    # release removes the file.
    with contextlib.suppress(OSError):
        Path(lock.lock_file).unlink()
    lock.release()
