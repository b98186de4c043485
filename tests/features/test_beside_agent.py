"""``run --features``: a process of its own, which measures the clocks of other computers."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pylsl
import pytest

from biosensor_gateway.cli import SEND_FEATURES
from biosensor_gateway.features import live as live_module
from biosensor_gateway.features.live import Live
from biosensor_gateway.system.logs import LOG_FILE_NAME
from tests.features.test_senders_in_bursts import Noted
from tests.rigs.lsl_streams import note_askers
from tests.rigs.polling import wait_until

pytestmark = pytest.mark.nightly

# ``run --features``: a process of its own, which comes back and ends with the agent.

DEADLINE_S = 60.0
ECG_PERIOD_S = 1 / 130


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
    wait_until(
        lambda: found.extend(pylsl.resolve_byprop("type", data_name, 1, 1.0)) or found, data_name
    )
    (info,) = (each for each in found if "polar_h10" in each.source_id())
    return pylsl.StreamInlet(info, recover=False)


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
def test_who_dies_comes_back_costs_no_sample_and_ends_with_the_agent(tmp_path: Path) -> None:
    with _agent(tmp_path) as agent:
        wait_until(lambda: _features_of(agent), "features")
        ecg = _inlet("ECG")
        stamps: list[float] = []
        wait_until(lambda: stamps.extend(ecg.pull_chunk(0.0)[1]) or stamps, "samples")
        (first,) = _features_of(agent)
        first.kill()
        wait_until(lambda: any(each.pid != first.pid for each in _features_of(agent)), "another")
        (second,) = (each for each in _features_of(agent) if each.pid != first.pid)
        wait_until(lambda: any("polar_h10" in each for each in _logged(tmp_path)), "the log")
        wait_until(
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
        wait_until(lambda: _has_ended(second), "its end")
    assert np.abs(np.diff(stamps)).max() < 1.5 * ECG_PERIOD_S
    said = "live features have ended (killed by SIGKILL) and are started again now"
    assert _logged(tmp_path).count(said) == 1


def test_heartbeats_tell_what_has_no_features(tmp_path: Path) -> None:
    _outlet = pylsl.StreamOutlet(pylsl.StreamInfo("Skin", "GSR", 1, 16.0, "float32", "skin"))
    with _agent(tmp_path):
        found: list[pylsl.StreamInfo] = []
        wait_until(
            lambda: (
                found.extend(pylsl.resolve_bypred("contains(source_id, '-events')", 1, 1.0))
                or found
            ),
            "events",
        )
        events = pylsl.StreamInlet(found[0], recover=False)
        heard: list[dict[str, object]] = []

        def has_told() -> bool:
            heard.extend(json.loads(each) for (each,) in events.pull_chunk(0.2)[0])
            return any(_of_gateway(each) for each in heard)

        wait_until(has_told, "a heartbeat with it")
        events.close_stream()
    (told,) = next(each for each in map(_of_gateway, heard) if each)
    assert str(told["what"]).startswith("live features of Skin: ")


def _of_gateway(event: Mapping[str, Any]) -> list[dict[str, object]]:
    problems: Mapping[str, list[dict[str, object]]] = event.get("problems", {})
    return problems.get("gateway", [])


@pytest.mark.skipif(sys.platform == "win32", reason="kills by signals")
def test_it_ends_with_an_agent_that_is_killed(tmp_path: Path) -> None:
    with _agent(tmp_path) as agent:
        wait_until(lambda: _features_of(agent), "features")
        (features,) = _features_of(agent)
        agent.kill()
        agent.wait(DEADLINE_S)
        wait_until(lambda: _has_ended(features), "its end")


# The clocks of other computers are measured by inlets that bring no data.
def test_an_inlet_of_data_is_never_asked_for_its_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would measure for the rest of its life, and grow: docs/liblsl-time-receiver.md."""
    monkeypatch.setattr(live_module, "SETTLED_S", 0.0)
    asked, pulled = note_askers(monkeypatch)
    info = pylsl.StreamInfo("pulse", "PPG", 1, 64.0, "float32", "pulse")
    channel = info.desc().append_child("channels").append_child("channel")
    channel.append_child_value("label", "green")
    channel.append_child_value("unit", "none")
    _outlet = pylsl.StreamOutlet(info)
    # Else its stamps need no correction.
    monkeypatch.setattr(socket, "gethostname", lambda: "another-computer")
    noted, stopping = Noted(), threading.Event()
    live = Live(noted)
    running = threading.Thread(target=live.run, args=[stopping])
    running.start()
    try:
        wait_until(lambda: noted.names == ["pulse"] and pulled and asked, "a measurement")
        (stage,) = live._stages.values()  # pyright: ignore[reportPrivateUsage]
        wait_until(lambda: (it := stage.connection) and it.correction is not None, "its result")
    finally:
        stopping.set()
        running.join()
    assert not {id(each) for each in asked} & {id(each) for each in pulled}
