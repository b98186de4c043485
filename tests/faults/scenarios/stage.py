"""Virtual devices in a process of their own, and agents that stream from some of them."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.system.logs import LOG_FILE_NAME
from tests.faults.agent import AgentProcess
from tests.faults.expectations import numeric_streams, source
from tests.rigs.lab_client import LabProcess, settings_toml

DEADLINE_S = 60.0
_POLL_S = 0.02


def wait_until(holds: Callable[[], object], what: str, deadline_s: float = DEADLINE_S) -> float:
    """Return the monotonic time at which it held; the test fails if it never does."""
    deadline = time.monotonic() + deadline_s
    while not holds():
        assert time.monotonic() < deadline, f"waited {deadline_s:.0f} s in vain: {what}"
        time.sleep(_POLL_S)
    return time.monotonic()


def lab_of(sensors: Sequence[str], folder: Path, **options: object) -> LabProcess:
    """One virtual device of each kind, which has its sensor's name as key."""
    devices = [
        {"key": name, "sensor": name, "options": {"seed": seed, **options}}
        for seed, name in enumerate(sensors, 1)
    ]
    return LabProcess(devices, folder)


def write_settings(
    folder: Path, lab: LabProcess, sensors: Mapping[str, str], participant: str = ""
) -> tuple[str, str]:
    """Write an agent's settings for some of the devices; return its arguments for them."""
    path = folder / "settings.toml"
    worn_by = dict.fromkeys(sensors, f'participant = "{participant}"' if participant else "")
    path.write_text(settings_toml(lab, sensors, worn_by))
    return "--settings", str(path)


def channels_of(sensors: Sequence[str]) -> dict[str, int]:
    """How many channels each numeric stream has, by source_id."""
    return {
        source(name, data_name): len(declaration(name).stream(data_name).channels)
        for name in sensors
        for data_name in numeric_streams(name)
    }


def is_streaming(agent: AgentProcess) -> bool:
    """Whether all its devices stream."""
    status = agent.status()
    return bool(status) and all(each["state"] == "streaming" for each in status.values())


@contextmanager
def doomed(
    folder: Path, *arguments: str, environment: Mapping[str, str]
) -> Generator[AgentProcess]:
    """Run an agent that is not asked to end: :func:`kill` it, or the block's end does."""
    agent = AgentProcess(folder, *arguments, environment=environment)
    try:
        yield agent
    finally:
        kill(agent)


def kill(agent: AgentProcess) -> None:
    """End it by SIGKILL, and see it dead; without effect if it is."""
    if agent.is_running:
        with suppress(ProcessLookupError):
            os.kill(agent.pid, signal.SIGKILL)
        wait_until(lambda: not agent.is_running, "the end of a killed process")


def log_path(folder: Path) -> Path:
    """Where an agent with that state folder logs."""
    return folder / LOG_FILE_NAME
