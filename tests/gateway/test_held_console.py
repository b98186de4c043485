"""A console or a disk that takes no output: the agent streams on, exactly, and obeys."""

from __future__ import annotations

import os
import signal
import statistics
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pylsl
import pytest

from biosensor_common import naming
from biosensor_common.errors import ConfigError
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import control, status_file
from biosensor_gateway.agent.control import CONTROL_FILE
from biosensor_gateway.devices.zephyr.simulator.wire import Packet
from biosensor_gateway.system.logs import LOG_FILE_NAME
from tests.rigs.held_console import HeldConsole
from tests.rigs.stopwatch import Stopwatch
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

DEADLINE_S = 30.0
PATIENCE_S = 10.0
ANSWERED_S = 1.0
"""What is required of the agent, from connecting to its answer."""
HELD = "the console takes no output"
# More than Linux keeps for a terminal, which is 64 KiB at most.
COMMANDS = 400
SAMPLES_MEANWHILE = 400

Until = Callable[[Callable[[], bool]], None]
OpenInlet = Callable[[str], pylsl.StreamInlet]

STOPPED_OR_UNREAD = pytest.mark.parametrize(
    "is_stopped", [False, True], ids=["nobody reads", "Ctrl-S"]
)


def run(folder: Path, port: str, unit: str) -> list[str]:
    settings = folder / "settings.toml"
    settings.write_text(f'[[device]]\nsensor = "zephyr"\nunit = "{unit}"\nport = "{port}"\n')
    program = [sys.executable, "-m", "biosensor_gateway.cli"]
    return [*program, "run", "--verbose", "--settings", str(settings)]


def environment(folder: Path) -> Mapping[str, str]:
    """Have liblsl say all that it can, from all its threads."""
    config = folder / "talkative.cfg"
    usual = Path(os.environ["LSLAPICFG"]).read_text()
    config.write_text(usual.replace("level = -2", "level = 9"))
    state = {"BIOSENSOR_GATEWAY_STATE": str(folder)}
    # There is a table below the log.
    terminal = {"NO_COLOR": "1", "TERM": "xterm"}
    return os.environ | state | terminal | {"LSLAPICFG": str(config)}


def ask(folder: Path, command: str, unit: str) -> dict[str, Any]:
    return control.ask(folder, command, {"device": f"zephyr/{unit}"}, PATIENCE_S)


def obeyed_s(folder: Path, unit: str) -> float:
    """Median time to an answer; a busy machine delays one of them, not most."""
    took: list[float] = []
    for _ in range(5):
        watch = Stopwatch()
        assert ask(folder, "pause", unit)["changed"]
        took.append(watch.elapsed_s())
        ask(folder, "resume", unit)
    return statistics.median(took)


def pushed(folder: Path) -> int:
    try:
        devices = status_file.read_status(folder)["devices"]
    except ConfigError:
        return 0
    return sum(stream["pushed"] for each in devices for stream in each["streams"].values())


def log(folder: Path) -> str:
    return (folder / LOG_FILE_NAME).read_text(encoding="utf-8")


def pull(stream: pylsl.StreamInlet, received: list[float]) -> int:
    samples: list[list[float]] = stream.pull_chunk()[0] or []
    received += [row[0] for row in samples]
    return len(received)


def assert_without_gap(received: list[float], device: SteeredBioHarness) -> None:
    """Everything that came stands in what the device has sent, in one piece."""
    sent = device.sent_samples(Packet.ECG)[:, 1].astype(np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(sent, len(received))
    assert (windows == np.array(received, np.float32)).all(axis=1).any()


@STOPPED_OR_UNREAD
def test_a_held_console_holds_up_neither_streams_nor_commands_nor_the_end(
    tmp_path: Path, until: Until, inlet: OpenInlet, unit: str, is_stopped: bool
) -> None:
    console = HeldConsole(is_stopped=is_stopped)
    with (
        SteeredBioHarness() as device,
        console.program(run(tmp_path, device.port, unit), environment(tmp_path)) as agent,
    ):
        until(lambda: pushed(tmp_path) > 0)
        for _ in range(COMMANDS):
            ask(tmp_path, "resume", unit)
        until(lambda: not console.takes_output)
        # liblsl's threads have to answer, and say so.
        ecg = inlet(naming.source_id(DeviceIdentity("zephyr", unit), "ecg"))
        received: list[float] = []
        until(lambda: pull(ecg, received) > SAMPLES_MEANWHILE)
        ask(tmp_path, "resume", unit)
        until(lambda: HELD in log(tmp_path))
        assert obeyed_s(tmp_path, unit) < ANSWERED_S
        assert ask(tmp_path, "pause", unit)["changed"]
        watch = Stopwatch()
        ask(tmp_path, "stop", unit)
        assert watch.free_s() < ANSWERED_S
        assert agent.wait(DEADLINE_S) == 0
        assert not console.takes_output
        assert_without_gap(received, device)
    assert log(tmp_path).count(HELD) == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_signal_ends_it_while_the_console_is_held(
    tmp_path: Path, until: Until, unit: str, number: signal.Signals
) -> None:
    console = HeldConsole(is_stopped=True)
    absent = run(tmp_path, str(tmp_path / "ttyUSB9"), unit)
    with console.program(absent, environment(tmp_path)) as agent:
        until((tmp_path / CONTROL_FILE).exists)
        agent.send_signal(number)
        assert agent.wait(DEADLINE_S) == 0
        assert not console.takes_output


@pytest.mark.seam
def test_a_released_console_shows_all_that_was_said_meanwhile_and_the_last_lines(
    tmp_path: Path, until: Until, unit: str
) -> None:
    console = HeldConsole(is_stopped=True)
    absent = run(tmp_path, str(tmp_path / "ttyUSB9"), unit)
    with console.program(absent, environment(tmp_path)) as agent:
        until((tmp_path / CONTROL_FILE).exists)
        for _ in range(20):
            ask(tmp_path, "resume", unit)
        console.release()
        until(lambda: console.shown.count("command='resume'") == 20)
        ask(tmp_path, "stop", unit)
        assert agent.wait(DEADLINE_S) == 0
        until(lambda: "command='stop'" in console.shown)
    # What liblsl says, which says it by itself, comes the same way.
    assert ".cpp:" in console.shown
    assert "Press Ctrl-C to end it." in console.shown
    assert "Traceback" not in console.shown
