"""The command line as a process, a running agent, and a LabRecorder to steer."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.lab_recorder.remote_control import LabRecorderPeer

END_S = 30.0


class Outcome(NamedTuple):
    code: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, Any]:
        return json.loads(self.out)


class CommandLine:
    """Runs ``biosensor-gateway`` with a state folder of its own."""

    def __init__(self, state: Path) -> None:
        self.state = state
        self._environment = os.environ | {
            "BIOSENSOR_GATEWAY_STATE": str(state),
            "BIOSENSOR_GATEWAY_SETTINGS": str(state / "none.toml"),
        }
        self._program = [sys.executable, "-m", "biosensor_gateway.cli"]

    def __call__(self, *arguments: str) -> Outcome:
        done = subprocess.run(
            [*self._program, *arguments],
            env=self._environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert "Traceback" not in done.stdout + done.stderr, done.stderr
        return Outcome(done.returncode, done.stdout, done.stderr)

    def begin(self, *arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*self._program, *arguments],
            env=self._environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    def watch(self, *arguments: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*self._program, *arguments], env=self._environment, stdout=subprocess.PIPE, text=True
        )


@pytest.fixture(scope="module")
def command_line(tmp_path_factory: pytest.TempPathFactory) -> CommandLine:
    return CommandLine(tmp_path_factory.mktemp("state"))


@pytest.fixture(scope="module")
def agent(command_line: CommandLine) -> Generator[CommandLine]:
    """The command line beside an agent whose virtual BioHarness streams."""
    process = command_line.begin("run", "--simulate", "zephyr")
    try:
        ready = command_line("wait-ready", "--timeout", str(END_S))
        assert ready.code == 0, ready.err
        yield command_line
        process.send_signal(signal.SIGINT)
        assert process.wait(END_S) == 0
    finally:
        process.kill()
        process.communicate()


@pytest.fixture
def recorder(tmp_path: Path) -> Generator[LabRecorderPeer]:
    root = tmp_path / "study root"
    root.mkdir()
    with LabRecorderPeer(root) as peer:
        yield peer


@pytest.fixture
def record(agent: CommandLine, recorder: LabRecorderPeer) -> Generator[Callable[..., Outcome]]:
    """``record`` for that LabRecorder; what one test started is unknown to the next."""

    def run(command: str, *arguments: str) -> Outcome:
        return agent("record", command, "--port", str(recorder.port), *arguments)

    yield run
    (agent.state / "recording.json").unlink(missing_ok=True)
