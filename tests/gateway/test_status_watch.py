"""``status --watch`` and ``wait-ready`` beside real agents."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Generator, Mapping
from os import environ
from pathlib import Path

import pytest

from biosensor_common.errors import GatewayError
from biosensor_gateway.agent import control, status_file
from tests.rigs.gateway import cli_process
from tests.rigs.polling import wait_until
from tests.rigs.terminal import at_terminal

pytestmark = pytest.mark.nightly

# ``status --watch``: a table at a terminal, lines elsewhere, and one JSON object a line.

PROGRAM = [sys.executable, "-m", "biosensor_gateway.cli"]
WATCH = [*PROGRAM, "status", "--watch"]
ROW = re.compile(r"^Zephyr BioHarness 3 +(\w+) +\S+", re.MULTILINE)
FOOT = "Press Ctrl-C to stop watching; the agent continues."


@pytest.fixture
def agent(tmp_path: Path) -> Generator[subprocess.Popen[bytes]]:
    with cli_process(tmp_path, "run", "--simulate", "zephyr") as process:
        wait_until(lambda: "streaming" in status(tmp_path))
        yield process


def environment(folder: Path) -> Mapping[str, str]:
    usual = {"BIOSENSOR_GATEWAY_STATE": str(folder), "TERM": "xterm-256color"}
    return os.environ | usual


def status(folder: Path) -> str:
    asked = [*PROGRAM, "status"]
    done = subprocess.run(asked, env=environment(folder), capture_output=True, check=False)
    return done.stdout.decode()


def ask(folder: Path, command: str, device: str = "zephyr") -> None:
    control.ask(folder, command, {"device": device}, 30.0)


@pytest.mark.usefixtures("agent")
def test_a_table_is_renewed_in_place_until_ctrl_c(tmp_path: Path) -> None:
    with at_terminal(WATCH, environment(tmp_path)) as terminal:
        terminal.until(lambda seen: [found[1] for found in ROW.finditer(seen)] == ["streaming"])
        ask(tmp_path, "pause")
        terminal.until(lambda seen: [found[1] for found in ROW.finditer(seen)] == ["paused"])
        pictures = terminal.screen.pictures
        shown = terminal.until(lambda _seen: terminal.screen.pictures > pictures + 2)
        assert shown.count(FOOT) == shown.count("Device ") == 1
        assert max(map(len, shown.splitlines())) < 80
        ask(tmp_path, "stop")
        shown = terminal.until_seen("no agent is running; start one with")
        assert not ROW.search(shown)
        terminal.type("\x03")
        assert terminal.exit_code() == 0


@pytest.mark.usefixtures("agent")
def test_elsewhere_a_line_tells_each_change(tmp_path: Path) -> None:
    with subprocess.Popen(WATCH, env=environment(tmp_path), stdout=subprocess.PIPE) as watching:
        assert watching.stdout is not None
        begun = watching.stdout.readline().decode()
        assert re.fullmatch(r"\d\d:\d\d:\d\d zephyr \(\S+\): streaming\n", begun)
        ask(tmp_path, "pause")
        changed = watching.stdout.readline().decode()
        assert changed[9:] == begun[9:].replace("streaming", "paused (streaming)")
        assert "\x1b" not in begun + changed
        ask(tmp_path, "stop")
        assert "no agent is running" in watching.stdout.readline().decode()
        watching.send_signal(signal.SIGINT)
        assert watching.wait(30) == 0


@pytest.mark.usefixtures("agent")
def test_json_is_one_object_a_line_and_the_same_as_without_watching(tmp_path: Path) -> None:
    once = [*PROGRAM, "status", "--json"]
    known = json.loads(subprocess.check_output(once, env=environment(tmp_path)))
    command = [*WATCH, "--json"]
    with subprocess.Popen(command, env=environment(tmp_path), stdout=subprocess.PIPE) as watching:
        assert watching.stdout is not None
        reports = [json.loads(watching.stdout.readline()) for _ in range(3)]
        times = [each["written"] for each in reports]
        assert times == sorted(set(times))
        assert all(each.keys() == known.keys() for each in reports)
        assert [each["unit"] for each in reports[0]["devices"]] == [
            each["unit"] for each in known["devices"]
        ]
        ask(tmp_path, "stop")
        while "problem" not in (last := json.loads(watching.stdout.readline())):
            pass
        assert list(last) == ["problem"]
        watching.send_signal(signal.SIGINT)
        assert watching.wait(30) == 0


def test_without_an_agent_it_does_not_begin(tmp_path: Path) -> None:
    done = subprocess.run(WATCH, env=environment(tmp_path), capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (1, b"")
    assert b"no agent is running" in done.stderr
    with pytest.raises(GatewayError):
        ask(tmp_path, "stop")


# ``wait-ready`` beside real agents.
DEADLINE_S = 60.0


def wait_ready(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "biosensor_gateway.cli", "wait-ready", *arguments],
        env=environ | {"BIOSENSOR_GATEWAY_STATE": str(folder)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_it_waits_for_an_agent_that_is_yet_to_start(tmp_path: Path) -> None:
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


def test_a_device_that_falls_silent_is_named_and_no_other(tmp_path: Path) -> None:
    options = ("--simulate", "zephyr,empatica_e4", "--fault", "zephyr:stall:120s@0s")
    with cli_process(tmp_path, "run", *options):
        waiting = wait_ready(tmp_path, "--timeout", "20")
        out, err = waiting.communicate(timeout=DEADLINE_S)
    assert (waiting.returncode, out) == (1, "")
    first, *missing = err.splitlines()
    assert re.fullmatch(r"not ready after 2\d s:", first)
    assert [line.startswith("- zephyr (virtual): ") for line in missing] == [True]


def test_what_a_model_has_only_in_name_is_not_waited_for(tmp_path: Path) -> None:
    # The virtual Muse 2 has no optics of an Athena, and its settings switch the aux off.
    with cli_process(tmp_path, "run", "--simulate", "muse"):
        waiting = wait_ready(tmp_path, "--timeout", str(DEADLINE_S), "--json")
        out, err = waiting.communicate(timeout=2 * DEADLINE_S)
        assert (waiting.returncode, err) == (0, "")
    assert json.loads(out)["streams"] == len({"eeg", "ppg", "acc", "gyro"})
