"""Keeps a program running: starts it again whenever it dies, from a standby if there is one."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType

from biosensor_common import relay
from biosensor_gateway.settings.places import state_folder
from biosensor_gateway.system import restart_notice
from biosensor_gateway.system.child import own_command
from biosensor_gateway.system.restart_notice import RestartNotice
from biosensor_gateway.system.standby import Standby

LONGEST_DELAY_S = 30.0
STABLE_AFTER_S = 60.0
"""Who lived so long did not die of its start, and is started again at once."""
STANDBY_AFTER_S = 5.0
"""Who lived so long is worth a standby. While it starts, it has the processor for itself."""

RESTARTS, LAST_END = "BIOSENSOR_GATEWAY_RESTARTS", "BIOSENSOR_GATEWAY_LAST_END"
"""Environment of the program: how often it was started again, and how it had ended before."""

_AS_IT_SHOULD, _WRONG_SETTINGS = 0, 2
_LOOK_S = 0.2
# Handlers of signals run between two waits. POSIX interrupts a wait, Windows does not.
_LONGEST_WAIT_S = _LOOK_S if sys.platform == "win32" else math.inf


def restart_facts(environment: Mapping[str, str]) -> dict[str, int | str]:
    """Return ``restarts`` and ``last_end`` of this program; nothing if it has not died before."""
    count = environment.get(RESTARTS, "")
    if not count.isdecimal() or not int(count):
        return {}
    return {"restarts": int(count), "last_end": environment.get(LAST_END, "")}


def next_delay_s(last_s: float | None, lived_s: float) -> float:
    """Return how long to wait before a program that has died is started again.

    Parameters
    ----------
    last_s
        How long it was the last time; None if it dies for the first time.
    lived_s
        How long the program lived.
    """
    if last_s is None or lived_s >= STABLE_AFTER_S:
        return 0.0
    return min(max(1.0, 2 * last_s), LONGEST_DELAY_S)


def keep_alive(arguments: Sequence[str]) -> int:
    """Keep this program running with other arguments; see :class:`KeepAlive`."""
    console = relay.console(relay.STDERR, "console")

    def tell(sentence: str) -> None:
        if console is not None:
            console.put(f"biosensor-gateway: {sentence}\n".encode())

    return KeepAlive(own_command(arguments), tell, state_folder()).run()


class KeepAlive:
    """Runs a program, and again whenever it dies, until it ends as it should.

    That is with code 0, or with 2, which says that its settings are wrong: they would be the
    next time. SIGINT, SIGTERM and SIGHUP are passed on, and end it for good. To be used in the
    main thread.

    Parameters
    ----------
    command
        Program and arguments; see `Standby` for what it must do.
    tell
        Is given a sentence about each death.
    folder
        Where `restart_notice` says that it waits.
    standby_after_s
        How long the program runs before it gets a standby.
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
        """Return the program's exit code at its proper end."""
        for number in _requests():
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
                self._tell(f"the agent has died ({last_end}) and is started again {when}")
            if delay_s:
                self._wait(delay_s, last_end)
            if self._is_asked_to_end:
                break
            code = self._run_once({RESTARTS: str(restarts), LAST_END: last_end})
            if code in {_AS_IT_SHOULD, _WRONG_SETTINGS} or self._is_asked_to_end:
                return code
            last_end = ending_in_words(code)
        return _AS_IT_SHOULD

    def _delays(self) -> Iterator[float]:
        """Yield how long to wait before each start; the first time, not at all."""
        yield 0.0
        delay_s: float | None = None
        while True:
            delay_s = next_delay_s(delay_s, self._lived_s)
            yield delay_s

    def _wait(self, seconds: float, last_end: str) -> None:
        """Let time pass before the next start, unless somebody asks for the end."""
        until = time.monotonic() + seconds
        notice = RestartNotice.of_this_process(seconds, last_end)
        is_announced = restart_notice.put_up(self._folder, notice)
        while not self._is_asked_to_end and (left := until - time.monotonic()) > 0:
            time.sleep(min(left, _LOOK_S))
            if is_announced and not restart_notice.is_up(self._folder):
                break
        if is_announced and not _take_down(self._folder):
            # `stop` has done so.
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
        """Wait for the end of the program, which gets a standby after a while."""
        code = _wait_for(process, self._standby_after_s)
        if code is None:
            # Without one, a start takes its second more.
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
        # Nobody else can, either.
        return True


def _requests() -> list[signal.Signals]:
    if sys.platform == "win32":
        return [signal.SIGINT, signal.SIGBREAK]
    return [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


def _ask_to_end(process: subprocess.Popen[bytes]) -> None:
    # A console of Windows tells all its programs by itself, and there, this would kill.
    if sys.platform != "win32":
        process.terminate()


_CRASHES = 0xC0000000
"""From here on Windows' exit codes are errors that end programs."""


def ending_in_words(code: int) -> str:
    """Say how a process ended, by its exit code."""
    if code >= _CRASHES:
        # Windows' own names of what ends a program are of this form.
        return f"crash {code:#010X}".replace("0X", "0x")
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"killed by signal {-code}"
