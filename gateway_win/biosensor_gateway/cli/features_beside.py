"""Has features sent in a process of their own beside the agent, and starts it again if it dies."""

from __future__ import annotations

import contextlib
import subprocess
import threading
import time
from typing import IO, Self

import structlog

from biosensor_gateway.cli import SEND_FEATURES
from biosensor_gateway.settings.models import LslSettings
from biosensor_gateway.system.keep_alive import ending_in_words, next_delay_s
from biosensor_gateway.system.own_command import close_input, start_for

_log = structlog.get_logger("biosensor_gateway.cli")

END_S = 5.0
"""How long it may take to close its streams."""


class FeaturesBeside:
    """Keeps the process running for as long as the context lasts.

    A process of its own, because what it computes must never make a sample of the agent late. It
    reads LSL like any other program. Its input is a pipe that only this process holds open, so
    that it ends also with an agent that is killed.

    Parameters
    ----------
    lsl
        Where the agent's streams are.
    """

    def __init__(self, lsl: LslSettings) -> None:
        self._lsl = lsl
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._keep, name="features", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._stopping.set()
            if self._process is not None:
                close_input(self._process)
        self._thread.join(END_S)
        if self._process is not None and self._thread.is_alive():
            self._process.kill()
            self._thread.join(END_S)

    def _keep(self) -> None:
        delay_s: float | None = None
        while not self._stopping.is_set():
            began = time.monotonic()
            ending = self._run_once()
            if self._stopping.is_set():
                return
            delay_s = next_delay_s(delay_s, time.monotonic() - began)
            when = f"in {delay_s:g} s" if delay_s else "now"
            _log.warning(f"live features have ended ({ending}) and are started again {when}")
            self._stopping.wait(delay_s)

    def _run_once(self) -> str:
        """Run it to its end; return how it ended."""
        try:
            process = self._started()
        except OSError as error:
            return f"not started: {error.strerror or error}"
        if process is None:
            return ""
        assert process.stdout is not None
        _log_lines(process.stdout)
        code = process.wait()
        with self._lock:
            close_input(process)
            self._process = None
        return ending_in_words(code)

    def _started(self) -> subprocess.Popen[bytes] | None:
        with self._lock:
            if self._stopping.is_set():
                return None
            process = start_for([SEND_FEATURES])
            self._process = process
            assert process.stdin is not None
            # If it has died already, its exit code says so.
            with contextlib.suppress(OSError):
                process.stdin.write(f"{self._lsl.model_dump_json(exclude_unset=True)}\n".encode())
                process.stdin.flush()
            return process


def _log_lines(output: IO[bytes]) -> None:
    with output:
        for line in output:
            _log.info(f"live features {line.decode(errors='replace').strip()}")
