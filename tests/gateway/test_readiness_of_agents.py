"""``wait-ready`` beside real agents."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from os import environ
from pathlib import Path

import pytest

from biosensor_gateway.agent import status_file

pytestmark = pytest.mark.nightly

StartCli = Callable[..., AbstractContextManager["subprocess.Popen[bytes]"]]

DEADLINE_S = 60.0


def wait_ready(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "biosensor_gateway.cli", "wait-ready", *arguments],
        env=environ | {"BIOSENSOR_GATEWAY_STATE": str(folder)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_it_waits_for_an_agent_that_is_yet_to_start(cli_process: StartCli, tmp_path: Path) -> None:
    waiting = wait_ready(tmp_path, "--timeout", str(DEADLINE_S), "--json")
    time.sleep(2)
    assert waiting.poll() is None
    # Nobody receives the strap's only steady stream, which then waits with its samples.
    with cli_process(tmp_path, "run", "--simulate", "zephyr,ble_heart_rate") as agent:
        out, err = waiting.communicate(timeout=2 * DEADLINE_S)
        assert (waiting.returncode, err) == (0, "")
        readiness = json.loads(out)
        streams = {
            source: counters
            for device in status_file.read_status(tmp_path)["devices"]
            for source, counters in device["streams"].items()
        }
        agent.send_signal(signal.SIGINT)
        assert agent.wait(DEADLINE_S) == 0
    assert readiness["ready"] is True
    assert (readiness["devices"], readiness["streams"]) == (2, 4)
    assert readiness["missing"] == []
    assert all(streams[f"zephyr-virtual-{name}"]["pushed"] for name in ("ecg", "breathing", "acc"))


def test_a_device_that_falls_silent_is_named_and_no_other(
    cli_process: StartCli, tmp_path: Path
) -> None:
    options = ("--simulate", "zephyr,empatica_e4", "--fault", "zephyr:stall:120s@0s")
    with cli_process(tmp_path, "run", *options):
        waiting = wait_ready(tmp_path, "--timeout", "20")
        out, err = waiting.communicate(timeout=DEADLINE_S)
    assert (waiting.returncode, out) == (1, "")
    first, *missing = err.splitlines()
    assert re.fullmatch(r"not ready after 2\d s:", first)
    assert [line.startswith("- zephyr (virtual): ") for line in missing] == [True]


def test_what_a_model_has_only_in_name_is_not_waited_for(
    cli_process: StartCli, tmp_path: Path
) -> None:
    # The virtual Muse 2 has no optics of an Athena, and its settings switch the aux off.
    with cli_process(tmp_path, "run", "--simulate", "muse"):
        waiting = wait_ready(tmp_path, "--timeout", str(DEADLINE_S), "--json")
        out, err = waiting.communicate(timeout=2 * DEADLINE_S)
        assert (waiting.returncode, err) == (0, "")
    assert json.loads(out)["streams"] == len({"eeg", "ppg", "acc", "gyro"})
