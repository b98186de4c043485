"""A file of the state folder that announces the restart of a crashed agent.

The supervisor (`keep_alive`) writes it while it waits. The process that removes it decides what
comes next: if it is the supervisor, the agent is started; if it is ``stop``, the supervisor ends.
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
    """Content of the file."""

    process: int  # Process id of the supervisor.
    at: float  # When the agent is restarted (Unix time, in seconds).
    last_end: str  # How the agent has ended, in words.

    @classmethod
    def of_this_process(cls, delay_s: float, last_end: str) -> Self:
        """Return the notice of a supervisor that begins to wait."""
        return cls(os.getpid(), time.time() + delay_s, last_end)

    @property
    def sentence(self) -> str:
        """The notice as a sentence for people."""
        left_s = max(0.0, self.at - time.time())
        return (
            f"no agent is running: it has died ({self.last_end}) and is restarted in "
            f"{left_s:.0f} s; to prevent that: biosensor-gateway stop"
        )


def put_up(folder: Path, notice: RestartNotice) -> bool:
    """Write the file; return whether that was possible."""
    try:
        state_file.replace(folder / RESTARTING_FILE, json.dumps(notice._asdict()))
    except OSError:
        return False
    return True


def is_up(folder: Path) -> bool:
    """Whether the file exists."""
    return (folder / RESTARTING_FILE).exists()


def take_down(folder: Path) -> bool:
    """Remove the file; return False if another process has removed it.

    Raises
    ------
    OSError
        If it cannot be removed.
    """
    path = folder / RESTARTING_FILE
    for _ in range(_TRIES - 1):
        try:
            path.unlink()
        except FileNotFoundError:
            return False
        except PermissionError:
            # Windows refuses while a reader has the file open.
            time.sleep(_PAUSE_S)
        else:
            return True
    path.unlink()
    return True


def read(folder: Path) -> RestartNotice | None:
    """Return the notice of a running supervisor; None if there is none."""
    try:
        content = json.loads(state_file.read(folder / RESTARTING_FILE))
        process, at = int(content["process"]), float(content["at"])
        notice = RestartNotice(process, at, str(content["last_end"]))
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None
    return notice if lives(notice.process) else None
