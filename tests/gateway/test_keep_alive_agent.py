"""A killed agent comes back by itself, says so, and ends when it is asked to."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from subprocess import Popen
from typing import Any

import numpy as np
import psutil
import pylsl
import pytest

from biosensor_common import naming
from biosensor_common.errors import ConfigError
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.agent import STREAMS_FILE
from biosensor_gateway.system.logs import LOG_FILE_NAME
from tests.gateway.test_agent_process import command, stop

DEADLINE_S = 30.0
ECG, ECG_STEP_S = "zephyr-virtual-ecg", 1 / 250
AFTER_S = 4.0

Until = Callable[[Callable[[], bool]], None]
StartCli = Callable[..., AbstractContextManager["Popen[bytes]"]]

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform == "win32", reason="kills by signals"),
]


def status(folder: Path) -> dict[str, Any]:
    try:
        return status_file.read_status(folder)
    except ConfigError:
        return {"devices": []}


def pushed(folder: Path) -> int:
    devices = status(folder)["devices"]
    return sum(each["pushed"] for device in devices for each in device["streams"].values())


class Events:
    """The heartbeats in the agent's stream of events, over its lives."""

    def __init__(self) -> None:
        source = naming.source_id(DeviceIdentity("gateway", os.uname().nodename), "events")
        (info,) = pylsl.resolve_byprop("source_id", source, timeout=DEADLINE_S)
        self._inlet = pylsl.StreamInlet(info, recover=True)
        self._heartbeats: list[dict[str, Any]] = []

    def heartbeats(self) -> list[dict[str, Any]]:
        while (sample := self._inlet.pull_sample(0.0)[0]) is not None:
            event = json.loads(sample[0])
            if event["event"] == "heartbeat":
                self._heartbeats.append(event)
        return self._heartbeats

    def close(self) -> None:
        self._inlet.close_stream()


def standby_of(supervisor: Popen[bytes], agent: int) -> int:
    """The process that waits beside the agent; 0 while there is none."""
    others = [each.pid for each in psutil.Process(supervisor.pid).children() if each.pid != agent]
    return others[0] if others else 0


@pytest.mark.seam
def test_a_killed_agent_comes_back_says_so_and_ends_when_asked(
    cli_process: StartCli, until: Until, tmp_path: Path
) -> None:
    with cli_process(tmp_path, "run", "--keep-alive", "--simulate", "zephyr") as supervisor:
        until(lambda: pushed(tmp_path) > 0 and (tmp_path / STREAMS_FILE).exists())
        killed = status(tmp_path)["process"]
        assert killed != supervisor.pid
        events = Events()
        until(lambda: len(events.heartbeats()) > 0)
        first = events.heartbeats()[-1]
        assert "restarts" not in first
        until(lambda: standby_of(supervisor, killed) != 0)
        standby = standby_of(supervisor, killed)
        os.kill(killed, signal.SIGKILL)
        until(lambda: status(tmp_path).get("process", killed) != killed and pushed(tmp_path) > 0)
        assert status(tmp_path)["process"] == standby
        assert status(tmp_path)["restarts"] == 1
        shown = command(tmp_path, "status").stdout
        assert "started again once, last after: killed by SIGKILL" in shown
        # Recorders hear it from a heartbeat: they are not back yet when the agent starts.
        until(lambda: events.heartbeats()[-1]["agent_started"] > first["agent_started"])
        second = events.heartbeats()[-1]
        assert (second["restarts"], second["last_end"]) == (1, "killed by SIGKILL")
        events.close()
        assert stop(tmp_path)[0] == 0
        assert supervisor.wait(DEADLINE_S) == 0
    said = (tmp_path / "stderr.txt").read_text()
    assert "the agent has died (killed by SIGKILL) and is started again now" in said
    log = [json.loads(line) for line in (tmp_path / LOG_FILE_NAME).read_text().splitlines()]
    (restart,) = [each for each in log if "was started again" in each["event"]]
    assert (restart["restarts"], restart["last_end"]) == (1, "killed by SIGKILL")
    assert not (tmp_path / STREAMS_FILE).exists()


def test_a_stream_goes_on_after_one_gap(
    cli_process: StartCli, until: Until, tmp_path: Path
) -> None:
    with cli_process(tmp_path, "run", "--keep-alive", "--simulate", "zephyr") as supervisor:
        until(lambda: pushed(tmp_path) > 0)
        killed = status(tmp_path)["process"]
        (info,) = pylsl.resolve_byprop("source_id", ECG, timeout=DEADLINE_S)
        reader = pylsl.StreamInlet(info, recover=True)
        until(lambda: standby_of(supervisor, killed) != 0)
        standby = standby_of(supervisor, killed)
        stamps = received(reader, until)
        os.kill(killed, signal.SIGKILL)
        killed_s = pylsl.local_clock()
        while stamps[-1] < killed_s + AFTER_S:
            stamps += received(reader, until)
        reader.close_stream()
        assert status(tmp_path)["process"] == standby
        assert stop(tmp_path)[0] == 0
        assert supervisor.wait(DEADLINE_S) == 0
    steps = np.diff(stamps)
    assert steps.min() > 0
    (gap,) = np.flatnonzero(steps > 2 * ECG_STEP_S)
    assert stamps[gap] <= killed_s < stamps[gap + 1]


def received(reader: pylsl.StreamInlet, until: Until) -> list[float]:
    stamps: list[float] = []

    def some_came() -> bool:
        stamps.extend(reader.pull_chunk(0.0, max_samples=1024)[1])
        return bool(stamps)

    until(some_came)
    return stamps
