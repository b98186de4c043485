"""Runs LSL or ROS for a check in a separate process with its own configuration.

A library may block for long, accept only one configuration per process, or end its process.
So each request to it runs in a separate process. The request is one line of JSON on stdin, the
answer one line on stdout::

    {"role": "find", "config": "[lab]...", "source_id": "doctor-5f", "timeout_s": 4}
    {"found": true}

The process ends by itself after ``life_s`` at the latest, and reads stdin no further: on
Windows, loading a library blocks while another thread reads from stdin.

`Probe` is the client; `serve` is the server, for LSL in `biosensor_common.doctor.lsl_process`.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

from biosensor_common.child import wait_or_kill

PROBE_COMMAND = "doctor-probe"
"""Hidden command of the frozen program, which has no separate Python."""
_LOG_LINES, _LOG_PATIENCE_S, _END_PATIENCE_S = 20, 1.0, 2.0


@dataclass(slots=True)
class SurveyedStream:
    """One stream as seen from this computer."""

    name: str
    source_id: str
    uid: str
    host: str
    format: str
    ports: list[int] = field(default_factory=list[int])
    offset_s: float | None = None  # Correction of its clock in s; None if it could not be measured.
    round_trip_s: float | None = None
    # Corrected stamp of a new sample minus its arrival time, in s; None if no sample came.
    stamp_error_s: float | None = None
    data_port: int = 0  # TCP port of its data over IPv4; 0 if it has none.
    session: str = ""


class ProbeError(Exception):
    """The process did not answer; the message has its last line of output."""


def probe_command() -> list[str]:
    """Return the command line of the LSL process, from source or frozen."""
    if getattr(sys, "frozen", False):
        return [sys.executable, PROBE_COMMAND]
    return [sys.executable, "-P", "-m", "biosensor_common.doctor.lsl_process"]


class Probe:
    """Client of a process that runs one request; a context manager.

    Parameters
    ----------
    command
        Its command line; by default that of `biosensor_common.doctor.lsl_process`.
    request
        Arguments of the role; for LSL always ``config``.
    """

    def __init__(
        self, role: str, limit_s: float, *, command: Sequence[str] = (), **request: object
    ) -> None:
        self.process = subprocess.Popen(
            command or probe_command(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            encoding="ascii",
            errors="replace",
        )
        self._log: deque[str] = deque(maxlen=_LOG_LINES)
        self._logger = threading.Thread(target=self._keep_log, daemon=True)
        self._logger.start()
        self._limit = threading.Timer(limit_s, self.process.kill)
        self._limit.daemon = True
        self._limit.start()
        self._request = json.dumps({"role": role, "life_s": limit_s, **request})

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._limit.cancel()
        self._end()
        for pipe in (self.process.stdin, self.process.stdout):
            # A request that was not written in full does not matter now.
            with contextlib.suppress(OSError):
                if pipe is not None:
                    pipe.close()

    def answer(self) -> dict[str, Any]:
        """Send the request and wait for the answer.

        Raises
        ------
        ProbeError
            The process ended, or was ended at its time limit.
        """
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        try:
            self.process.stdin.write(self._request + "\n")
            self.process.stdin.flush()
            # pylsl may print messages to stdout, too.
            while line := self.process.stdout.readline():
                if line.startswith("{"):
                    return json.loads(line)
        except (OSError, ValueError):
            pass
        raise ProbeError(f"a second process did not answer{self._last_words()}")

    def _end(self) -> None:
        # Time to announce its end in the network, as ROS nodes do.
        self.process.terminate()
        wait_or_kill(self.process, _END_PATIENCE_S)

    def _keep_log(self) -> None:
        assert self.process.stderr is not None
        with self.process.stderr as lines:
            self._log.extend(lines)

    def _last_words(self) -> str:
        self._logger.join(_LOG_PATIENCE_S)
        lines = [line.strip() for line in list(self._log) if line.strip()]
        return f": {lines[-1]}" if lines else ""


def serve(roles: Mapping[str, Callable[..., object]]) -> None:
    """Run the request from stdin, write the answer that its role returns, if any, and exit."""
    request: dict[str, Any] = json.loads(sys.stdin.readline())
    life = threading.Timer(request.pop("life_s"), os._exit, args=(1,))
    life.daemon = True
    life.start()
    content = roles[request.pop("role")](**request)
    if content is not None:
        answer(content)
    # Threads of libraries that wait for the network would delay a normal exit.
    os._exit(0)


def answer(content: object) -> None:
    """Write the answer to stdout; for roles that answer before they end."""
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()
