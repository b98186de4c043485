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
from types import TracebackType
from typing import Any, Self

import psutil

from biosensor_common.errors import ConfigError
from biosensor_gateway.agent import status_file
from biosensor_gateway.system.logs import LOG_FILE_NAME

_STOP_LIMIT_S = 30.0


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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
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
        return int(status_file.read_status(self._folder)["process"])

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
        """What the agent says of itself, by sensor; empty before it has said anything."""
        assert self.is_running, self.console()
        try:
            status = status_file.read_status(self._folder)
        except ConfigError:
            return {}
        process = status["process"]
        assert process == self.pid or process in self._children()
        return {device["sensor"]: device for device in status["devices"]}

    def log(self) -> list[dict[str, Any]]:
        """Everything that it has logged, as records."""
        path = self._folder / LOG_FILE_NAME
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        return [json.loads(line) for line in lines]

    def _children(self) -> set[int]:
        return {each.pid for each in psutil.Process(self.pid).children()}
