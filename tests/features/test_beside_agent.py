"""``run --features``: a process of its own, which comes back and ends with the agent."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil
import pylsl
import pytest

from biosensor_gateway.cli import SEND_FEATURES
from biosensor_gateway.system.logs import LOG_FILE_NAME

DEADLINE_S = 30.0
ECG_PERIOD_S = 1 / 130

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform == "win32", reason="kills by signals"),
]


def _until(condition: Callable[[], object], what: str) -> None:
    end = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < end, what
        time.sleep(0.05)


@contextmanager
def _agent(folder: Path) -> Generator[psutil.Popen]:
    command = [sys.executable, "-m", "biosensor_gateway.cli", "run", "--features"]
    environment = {**os.environ, "BIOSENSOR_GATEWAY_STATE": str(folder)}
    with (folder / "said.txt").open("wb") as said:
        process = psutil.Popen(
            [*command, "--simulate", "polar_h10"],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=said,
        )
    try:
        yield process
    finally:
        if process.is_running():
            process.kill()
        process.wait(DEADLINE_S)


def _features_of(agent: psutil.Process) -> list[psutil.Process]:
    return [each for each in agent.children() if not _has_ended(each) and _sends_features(each)]


def _sends_features(process: psutil.Process) -> bool:
    try:
        return SEND_FEATURES in process.cmdline()
    except psutil.Error:
        # It has ended since.
        return False


def _has_ended(process: psutil.Process) -> bool:
    try:
        return process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def _logged(folder: Path) -> list[str]:
    file = folder / LOG_FILE_NAME
    lines = file.read_text().splitlines() if file.exists() else []
    return [json.loads(each)["event"] for each in lines]


def _inlet(data_name: str) -> pylsl.StreamInlet:
    found: list[pylsl.StreamInfo] = []
    _until(
        lambda: found.extend(pylsl.resolve_byprop("type", data_name, 1, 1.0)) or found, data_name
    )
    (info,) = (each for each in found if "polar_h10" in each.source_id())
    return pylsl.StreamInlet(info, recover=False)


def test_who_dies_comes_back_costs_no_sample_and_ends_with_the_agent(tmp_path: Path) -> None:
    with _agent(tmp_path) as agent:
        _until(lambda: _features_of(agent), "features")
        ecg = _inlet("ECG")
        stamps: list[float] = []
        _until(lambda: stamps.extend(ecg.pull_chunk(0.0)[1]) or stamps, "samples")
        (first,) = _features_of(agent)
        first.kill()
        _until(lambda: any(each.pid != first.pid for each in _features_of(agent)), "another")
        (second,) = (each for each in _features_of(agent) if each.pid != first.pid)
        _until(lambda: any("polar_h10" in each for each in _logged(tmp_path)), "the log")
        _until(
            lambda: any(
                "live features of" in each and "beats" in each for each in _logged(tmp_path)
            ),
            "features of the strap",
        )
        _inlet("Activity").close_stream()
        stamps.extend(ecg.pull_chunk(0.0, 8192)[1])
        ecg.close_stream()
        agent.send_signal(signal.SIGTERM)
        assert agent.wait(DEADLINE_S) == 0
        _until(lambda: _has_ended(second), "its end")
    assert np.abs(np.diff(stamps)).max() < 1.5 * ECG_PERIOD_S
    said = "live features have ended (killed by SIGKILL) and are started again now"
    assert _logged(tmp_path).count(said) == 1


def test_it_ends_with_an_agent_that_is_killed(tmp_path: Path) -> None:
    with _agent(tmp_path) as agent:
        _until(lambda: _features_of(agent), "features")
        (features,) = _features_of(agent)
        agent.kill()
        agent.wait(DEADLINE_S)
        _until(lambda: _has_ended(features), "its end")
