"""The agent as a process, with its status and its log."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import psutil

from biosensor_common.errors import ConfigError
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.system.logs import LOG_FILE_NAME

_STOP_LIMIT_S = 30.0
_PATIENCE_S = 30.0
_POLL_S = 0.05


def fresh_status(folder: Path) -> dict[str, Any]:
    """What the agent with this state folder says of itself.

    What a busy one has said last may be too old to count; it is waited for as long as it runs.

    Raises
    ------
    ConfigError
        If none runs there, or it says nothing for half a minute.
    """
    deadline = time.monotonic() + _PATIENCE_S
    while True:
        try:
            return status_file.read_status(folder)
        except ConfigError:
            if time.monotonic() > deadline or not is_held(folder):
                raise
        time.sleep(_POLL_S)


class AgentProcess:
    """``biosensor-gateway run``; a context manager that asks it to end, which it must do cleanly.

    Parameters
    ----------
    folder
        Gets its state and what it prints.
    arguments
        Behind ``run``.
    environment
        Besides that of the test.
    """

    def __init__(self, folder: Path, *arguments: str, environment: Mapping[str, str]) -> None:
        self._folder = folder
        with (folder / "console.txt").open("wb") as console:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "biosensor_gateway.cli", "run", *arguments],
                env={**os.environ, **environment, "BIOSENSOR_GATEWAY_STATE": str(folder)},
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=subprocess.STDOUT,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._process.send_signal(signal.SIGINT)
            code = self._process.wait(_STOP_LIMIT_S)
        finally:
            self._process.kill()
            self._process.wait()
        assert code == 0, self.console()

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def serving(self) -> int:
        """The process that is the agent; with ``--keep-alive`` not `pid`."""
        return int(fresh_status(self._folder)["process"])

    @property
    def standby(self) -> int | None:
        """The process that waits beside it, with ``--keep-alive``; None while there is none."""
        waiting = self._children() - {self.serving}
        return min(waiting, default=None)

    @property
    def is_running(self) -> bool:
        return self._process.poll() is None

    def sleep(self, seconds: float) -> None:
        """Stop it for so long; it gets no time, and the system goes on buffering for it."""
        self._process.send_signal(signal.SIGSTOP)
        try:
            time.sleep(seconds)
        finally:
            self._process.send_signal(signal.SIGCONT)

    def console(self) -> str:
        return (self._folder / "console.txt").read_text(errors="replace")

    def status(self) -> dict[str, Any]:
        """What the agent says of itself, by sensor; empty if it has said nothing of late."""
        assert self.is_running, self.console()
        try:
            status = status_file.read_status(self._folder)
        except ConfigError:
            return {}
        process = status["process"]
        assert process == self.pid or process in self._children()
        return {device["sensor"]: device for device in status["devices"]}

    def devices(self) -> dict[str, Any]:
        """The same, once it says something."""
        deadline = time.monotonic() + _PATIENCE_S
        while not (status := self.status()):
            assert time.monotonic() < deadline, f"it says nothing: {self.console()}"
            time.sleep(_POLL_S)
        return status

    def log(self) -> list[dict[str, Any]]:
        """Everything that it has logged, as records."""
        path = self._folder / LOG_FILE_NAME
        # The last line may be half written; what is behind the last end of a line is no record.
        lines = path.read_bytes().split(b"\n")[:-1] if path.exists() else []
        return [json.loads(line) for line in lines]

    def _children(self) -> set[int]:
        return {each.pid for each in psutil.Process(self.pid).children()}
