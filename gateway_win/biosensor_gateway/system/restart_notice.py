"""A file of the state folder says that a dead agent is started again in a while.

The supervisor (`keep_alive`) puts it up for as long as it waits. Whoever takes it down decides what
comes next: the supervisor, which then starts the agent, or ``stop``, after which it ends.
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import NamedTuple, Self

from biosensor_gateway.system import state_file
from biosensor_gateway.system.child import lives

RESTARTING_FILE = "restarting.json"

_TRIES = 5
_PAUSE_S = 0.01


class RestartNotice(NamedTuple):
    """What the file says.

    Attributes
    ----------
    process
        Number of the supervisor.
    at
        When the agent is started again (Unix time, in seconds).
    last_end
        How it has ended, in words.
    """

    process: int
    at: float
    last_end: str

    @classmethod
    def of_this_process(cls, delay_s: float, last_end: str) -> Self:
        """Return the notice of a supervisor that begins to wait."""
        return cls(os.getpid(), time.time() + delay_s, last_end)

    @property
    def sentence(self) -> str:
        """Says it to a person."""
        left_s = max(0.0, self.at - time.time())
        return (
            f"no agent is running: it has died ({self.last_end}) and is started again in "
            f"{left_s:.0f} s; if it should not be: biosensor-gateway stop"
        )


def put_up(folder: Path, notice: RestartNotice) -> bool:
    """Write the file; return whether that was possible."""
    try:
        state_file.replace(folder / RESTARTING_FILE, json.dumps(notice._asdict()))
    except OSError:
        return False
    return True


def is_up(folder: Path) -> bool:
    """Whether the file is there, whoever wrote it."""
    return (folder / RESTARTING_FILE).exists()


def take_down(folder: Path) -> bool:
    """Remove the file; return False if somebody else has done so.

    Raises
    ------
    OSError
        It cannot be removed.
    """
    path = folder / RESTARTING_FILE
    for _ in range(_TRIES - 1):
        try:
            path.unlink()
        except FileNotFoundError:
            return False
        except PermissionError:
            # Windows refuses for as long as a reader has it open.
            time.sleep(_PAUSE_S)
        else:
            return True
    path.unlink()
    return True


def read(folder: Path) -> RestartNotice | None:
    """Return what a supervisor that lives has put up; None if there is none."""
    try:
        said = json.loads(state_file.read(folder / RESTARTING_FILE))
        notice = RestartNotice(int(said["process"]), float(said["at"]), str(said["last_end"]))
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None
    return notice if lives(notice.process) else None
