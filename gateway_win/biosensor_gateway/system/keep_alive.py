"""Keeps a program running: starts it again whenever it dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import FrameType

from biosensor_common import relay

LONGEST_DELAY_S = 30.0
STABLE_AFTER_S = 60.0
"""Who lived so long did not die of its start, and is started again at once."""

RESTARTS, LAST_END = "BIOSENSOR_GATEWAY_RESTARTS", "BIOSENSOR_GATEWAY_LAST_END"
"""Environment of the program: how often it was started again, and how it had ended before."""

_AS_IT_SHOULD, _WRONG_SETTINGS = 0, 2
# Handlers of signals run between two waits. POSIX interrupts a wait, Windows does not.
_LONGEST_WAIT_S = 0.2 if sys.platform == "win32" else None


def restart_facts(environment: Mapping[str, str]) -> dict[str, int | str]:
    """Return ``restarts`` and ``last_end`` of this program; nothing if it has not died before."""
    count = environment.get(RESTARTS, "")
    if not count.isdecimal() or not int(count):
        return {}
    return {"restarts": int(count), "last_end": environment.get(LAST_END, "")}


def own_command(arguments: Sequence[str]) -> list[str]:
    """Return the command line that runs this program with arguments."""
    is_frozen = bool(getattr(sys, "frozen", False))
    if is_frozen:
        return [sys.executable, *arguments]
    return [sys.executable, "-P", "-m", "biosensor_gateway.cli", *arguments]


def keep_alive(arguments: Sequence[str]) -> int:
    """Keep this program running with other arguments; see :class:`KeepAlive`."""
    console = relay.console(relay.STDERR, "console")

    def tell(sentence: str) -> None:
        if console is not None:
            console.put(f"biosensor-gateway: {sentence}\n".encode())

    return KeepAlive(own_command(arguments), tell).run()


class KeepAlive:
    """Runs a program, and again whenever it dies, until it ends as it should.

    That is with code 0, or with 2, which says that its settings are wrong: they would be the
    next time. SIGINT, SIGTERM and SIGHUP are passed on, and end it for good. To be used in the
    main thread.

    Parameters
    ----------
    command
        Program and arguments.
    tell
        Is given a sentence about each death.
    """

    def __init__(self, command: Sequence[str], tell: Callable[[str], object]) -> None:
        self._command, self._tell = command, tell
        self._process: subprocess.Popen[bytes] | None = None
        self._is_asked_to_end = False
        self._lived_s = 0.0

    def run(self) -> int:
        """Return the program's exit code at its proper end."""
        for number in _requests():
            signal.signal(number, self._pass_on)
        last_end = ""
        for restarts, delay_s in enumerate(self._delays()):
            if restarts:
                when = f"in {delay_s:g} s" if delay_s else "now"
                self._tell(f"the agent has died ({last_end}) and is started again {when}")
            self._sleep(delay_s)
            if self._is_asked_to_end:
                break
            code = self._run_once({RESTARTS: str(restarts), LAST_END: last_end})
            if code in {_AS_IT_SHOULD, _WRONG_SETTINGS} or self._is_asked_to_end:
                return code
            last_end = _described(code)
        return _AS_IT_SHOULD

    def _delays(self) -> Iterator[float]:
        """Yield how long to wait before each start; the first time, not at all."""
        yield 0.0
        delay_s = 0.0
        while True:
            if self._lived_s >= STABLE_AFTER_S:
                delay_s = 0.0
            yield delay_s
            delay_s = min(max(1.0, 2 * delay_s), LONGEST_DELAY_S)

    def _sleep(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while not self._is_asked_to_end and (left := until - time.monotonic()) > 0:
            time.sleep(min(left, 0.2))

    def _run_once(self, environment: Mapping[str, str]) -> int:
        began = time.monotonic()
        with subprocess.Popen(  # noqa: S603 - our own program
            self._command, env={**os.environ, **environment}
        ) as process:
            self._process = process
            if self._is_asked_to_end:
                _ask_to_end(process)
            while True:
                try:
                    code = process.wait(_LONGEST_WAIT_S)
                except subprocess.TimeoutExpired:
                    continue
                break
        self._lived_s = time.monotonic() - began
        return code

    def _pass_on(self, _number: int, _frame: FrameType | None) -> None:
        self._is_asked_to_end = True
        if self._process is not None:
            _ask_to_end(self._process)


def _requests() -> list[signal.Signals]:
    if sys.platform == "win32":
        return [signal.SIGINT, signal.SIGBREAK]
    return [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


def _ask_to_end(process: subprocess.Popen[bytes]) -> None:
    # A console of Windows tells all its programs by itself, and there, this would kill.
    if sys.platform != "win32":
        process.terminate()


def _described(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    try:
        return f"killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"killed by signal {-code}"
