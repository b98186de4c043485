"""A second process of a program, which has imported everything and waits until it is needed.

What a start takes is Python and its imports. A program that may be needed at once has them behind
it: it is started with `STANDBY` in its environment, and `await_turn` keeps it from going on until
its keeper gives it the turn, as one line of JSON on its standard input. The end of that input
says that the keeper has gone.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence

STANDBY = "BIOSENSOR_GATEWAY_STANDBY"
"""Environment of a process that is to wait for its turn."""

_STDIN = 0
_TERMINAL = "CONIN$" if sys.platform == "win32" else "/dev/tty"


class Standby:
    """The keeper's side of it. Raises ``OSError`` if it cannot be started.

    Parameters
    ----------
    command
        Program and arguments; it must call `await_turn` before it opens or claims anything.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, bufsize=0, env={**os.environ, STANDBY: "1"}
        )

    def take_turn(self, environment: Mapping[str, str]) -> subprocess.Popen[bytes] | None:
        """Have it go on, with more in its environment; return None if it has died meanwhile."""
        terminal = sys.stdin is not None and sys.stdin.isatty()
        turn = json.dumps({"environment": dict(environment), "terminal": terminal})
        assert self._process.stdin is not None
        try:
            if self._process.poll() is None:
                self._process.stdin.write(f"{turn}\n".encode())
                self._process.stdin.close()
                return self._process
        except OSError:
            # It has died, and nobody reads any more.
            pass
        self.end()
        return None

    def end(self) -> None:
        """End it; it holds nothing that it would have to give back."""
        with self._process as process:
            process.kill()


def is_standby() -> bool:
    """Whether this process is to call `await_turn`."""
    return STANDBY in os.environ


def await_turn() -> None:
    """Wait until this process is needed, and then be like one that was started just now.

    Raises
    ------
    SystemExit
        With code 0: the keeper has gone.
    """
    del os.environ[STANDBY]
    with open(_STDIN, "rb", buffering=0, closefd=False) as keeper:
        line = keeper.readline()
    if not line.endswith(b"\n"):
        raise SystemExit(0)
    turn = json.loads(line)
    os.environ.update(turn["environment"])
    _lead_stdin(_TERMINAL if turn["terminal"] else os.devnull)


def _lead_stdin(path: str) -> None:
    """Have standard input come from elsewhere than from the keeper."""
    try:
        opened = os.open(path, os.O_RDWR)
    except OSError:
        opened = os.open(os.devnull, os.O_RDWR)
    os.dup2(opened, _STDIN)
    os.close(opened)
    if sys.platform == "win32":
        # Python's own object for a pipe cannot read from a console.
        sys.stdin = open(_STDIN, encoding="utf-8", errors="replace", closefd=False)  # noqa: SIM115 - for as long as it lives
