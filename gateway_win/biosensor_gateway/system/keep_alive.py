"""Supervises a program: restarts it after a crash, from a warm spare if there is one.

Most of the time of a start goes into Python and its imports. A spare has done both: it is started
with `STANDBY` in its environment, and waits in `await_turn` until the supervisor sends one line of
JSON to its standard input. The end of that input means that the supervisor has ended.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType

from biosensor_common import nonblocking_writer
from biosensor_common.child import END_SIGNALS, Backoff, ending_in_words
from biosensor_gateway.settings.places import state_folder
from biosensor_gateway.system import restart_notice
from biosensor_gateway.system.child import first_line, own_command
from biosensor_gateway.system.restart_notice import RestartNotice

STANDBY_AFTER_S = 5.0
"""How long the program runs before a spare is started, which would compete for the processor."""

RESTARTS, LAST_END = "BIOSENSOR_GATEWAY_RESTARTS", "BIOSENSOR_GATEWAY_LAST_END"
"""Environment of the program: how often it was restarted, and how it had ended before."""

STANDBY = "BIOSENSOR_GATEWAY_STANDBY"
"""Environment of a spare, which has to wait until it is needed."""

_STDIN = 0
_TERMINAL = "CONIN$" if sys.platform == "win32" else "/dev/tty"
_CLEAN, _WRONG_SETTINGS = 0, 2
_LOOK_S = 0.2
# Signal handlers run between two waits: signals interrupt a wait on POSIX, but not on Windows.
_LONGEST_WAIT_S = _LOOK_S if sys.platform == "win32" else math.inf


def restart_facts(environment: Mapping[str, str]) -> dict[str, int | str]:
    """Return ``restarts`` and ``last_end`` of this program; empty if it was never restarted."""
    count = environment.get(RESTARTS, "")
    if not count.isdecimal() or not int(count):
        return {}
    return {"restarts": int(count), "last_end": environment.get(LAST_END, "")}


def keep_alive(arguments: Sequence[str]) -> int:
    """Supervise this program with other arguments; see :class:`KeepAlive`."""
    console = nonblocking_writer.console(nonblocking_writer.STDERR, "console")

    def tell(sentence: str) -> None:
        if console is not None:
            console.put(f"biosensor-gateway: {sentence}\n".encode())

    return KeepAlive(own_command(arguments), tell, state_folder()).run()


class Standby:
    """A warm spare: a second process of the program, which waits until it is needed.

    Raises ``OSError`` if it cannot be started.

    Parameters
    ----------
    command
        Program and arguments; the program must call `await_turn` before it opens anything.
    """

    def __init__(self, command: Sequence[str]) -> None:
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, bufsize=0, env={**os.environ, STANDBY: "1"}
        )

    def take_turn(self, environment: Mapping[str, str]) -> subprocess.Popen[bytes] | None:
        """Let the spare run, with more environment variables; return None if it has ended."""
        terminal = sys.stdin is not None and sys.stdin.isatty()
        turn = json.dumps({"environment": dict(environment), "terminal": terminal})
        assert self._process.stdin is not None
        try:
            if self._process.poll() is None:
                self._process.stdin.write(f"{turn}\n".encode())
                self._process.stdin.close()
                return self._process
        except OSError:
            # It has ended since `poll`, so that nobody reads the pipe.
            pass
        self.end()
        return None

    def end(self) -> None:
        """Kill the spare, which has opened nothing that would have to be closed."""
        with self._process as process:
            process.kill()


class KeepAlive:
    """Runs a program, and restarts it after each crash.

    Exit code 0 is a clean end. Exit code 2 means wrong settings, which a restart would not change.
    SIGINT, SIGTERM and SIGHUP are passed on, and end the program for good. To be used in the main
    thread.

    Parameters
    ----------
    command
        Program and arguments; see `Standby` for what it must do.
    tell
        Called with a sentence about each crash.
    folder
        State folder, for the `restart_notice`.
    standby_after_s
        How long the program runs before a spare is started.
    """

    def __init__(
        self,
        command: Sequence[str],
        tell: Callable[[str], object],
        folder: Path,
        standby_after_s: float = STANDBY_AFTER_S,
    ) -> None:
        self._command, self._tell = command, tell
        self._folder = folder
        self._standby_after_s = standby_after_s
        self._process: subprocess.Popen[bytes] | None = None
        self._standby: Standby | None = None
        self._is_asked_to_end = False
        self._lived_s = 0.0

    def run(self) -> int:
        """Run until the clean end of the program; return its exit code."""
        for number in END_SIGNALS:
            signal.signal(number, self._pass_on)
        try:
            return self._run()
        finally:
            if self._standby is not None:
                self._standby.end()

    def _run(self) -> int:
        last_end = ""
        for restarts, delay_s in enumerate(self._delays()):
            if restarts:
                when = f"in {delay_s:g} s" if delay_s else "now"
                self._tell(f"the agent has died ({last_end}) and is restarted {when}")
            if delay_s:
                self._wait(delay_s, last_end)
            if self._is_asked_to_end:
                break
            code = self._run_once({RESTARTS: str(restarts), LAST_END: last_end})
            if code in {_CLEAN, _WRONG_SETTINGS} or self._is_asked_to_end:
                return code
            last_end = ending_in_words(code)
        return _CLEAN

    def _delays(self) -> Iterator[float]:
        """Yield how long to wait before each start; 0 for the first."""
        yield 0.0
        backoff = Backoff()
        while True:
            yield backoff.next_s(self._lived_s)

    def _wait(self, seconds: float, last_end: str) -> None:
        """Wait before the next start, unless the end is requested."""
        until = time.monotonic() + seconds
        notice = RestartNotice.of_this_process(seconds, last_end)
        is_announced = restart_notice.put_up(self._folder, notice)
        while not self._is_asked_to_end and (left := until - time.monotonic()) > 0:
            time.sleep(min(left, _LOOK_S))
            if is_announced and not restart_notice.is_up(self._folder):
                break
        if is_announced and not _take_down(self._folder):
            # `stop` has removed the notice.
            self._is_asked_to_end = True

    def _run_once(self, environment: Mapping[str, str]) -> int:
        began = time.monotonic()
        with self._started(environment) as process:
            self._process = process
            if self._is_asked_to_end:
                _ask_to_end(process)
            code = self._code_of(process)
        self._lived_s = time.monotonic() - began
        return code

    def _started(self, environment: Mapping[str, str]) -> subprocess.Popen[bytes]:
        standby, self._standby = self._standby, None
        process = standby.take_turn(environment) if standby is not None else None
        if process is not None:
            return process
        return subprocess.Popen(self._command, env={**os.environ, **environment})

    def _code_of(self, process: subprocess.Popen[bytes]) -> int:
        """Wait for the end of the program, and start a spare after a while."""
        code = _wait_for(process, self._standby_after_s)
        if code is None:
            # Without a spare, the next start takes a second longer.
            with contextlib.suppress(OSError):
                self._standby = Standby(self._command)
            code = _wait_for(process)
        assert code is not None
        return code

    def _pass_on(self, _number: int, _frame: FrameType | None) -> None:
        self._is_asked_to_end = True
        if self._process is not None:
            _ask_to_end(self._process)


def _wait_for(process: subprocess.Popen[bytes], limit_s: float = math.inf) -> int | None:
    """Return the exit code; None if it has not ended within the limit."""
    until = time.monotonic() + limit_s
    while (left := min(until - time.monotonic(), _LONGEST_WAIT_S)) > 0:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(None if left == math.inf else left)
    return process.poll()


def _take_down(folder: Path) -> bool:
    try:
        return restart_notice.take_down(folder)
    except OSError:
        # Then `stop` cannot have removed it, either.
        return True


def _ask_to_end(process: subprocess.Popen[bytes]) -> None:
    # A Windows console notifies all its programs by itself, and `terminate` would kill there.
    if sys.platform != "win32":
        process.terminate()


def is_standby() -> bool:
    """Whether this process is a spare, which has to call `await_turn`."""
    return STANDBY in os.environ


def await_turn() -> None:
    """Wait until this spare is needed, then take over the environment of a new process.

    Raises
    ------
    SystemExit
        With code 0 if the supervisor has ended.
    """
    del os.environ[STANDBY]
    line = first_line()
    if not line.endswith(b"\n"):
        raise SystemExit(0)
    turn = json.loads(line)
    os.environ.update(turn["environment"])
    _redirect_stdin(_TERMINAL if turn["terminal"] else os.devnull)


def _redirect_stdin(path: str) -> None:
    """Read standard input from a file instead of the supervisor's pipe."""
    try:
        opened = os.open(path, os.O_RDWR)
    except OSError:
        opened = os.open(os.devnull, os.O_RDWR)
    os.dup2(opened, _STDIN)
    os.close(opened)
    if sys.platform == "win32":
        # Python's own object for a pipe cannot read from a console.
        sys.stdin = open(_STDIN, encoding="utf-8", errors="replace", closefd=False)  # noqa: SIM115 - for as long as it lives
