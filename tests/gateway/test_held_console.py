"""A console or a disk that takes no output: the agent streams on."""

from __future__ import annotations

import json
import math
import os
import re
import select
import signal
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pylsl
import pytest
import structlog

from biosensor_common import naming
from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import control, status_file
from biosensor_gateway.agent.control import CONTROL_FILE
from biosensor_gateway.devices.zephyr.simulator.wire import Packet
from biosensor_gateway.settings.models import LogSettings
from biosensor_gateway.system import logs
from biosensor_gateway.system.logs import LOG_FILE_NAME, configure_logs
from tests.rigs.gateway import inlet
from tests.rigs.polling import wait_until
from tests.rigs.stopwatch import Stopwatch
from tests.rigs.terminal import HeldConsole
from tests.rigs.zephyr import SteeredBioHarness

pytestmark = pytest.mark.nightly

# A console or a disk that takes no output: the agent streams on, exactly, and obeys.

DEADLINE_S = 30.0
PATIENCE_S = 10.0
ANSWERED_S = 1.0
"""What is required of the agent, from connecting to its answer."""
HELD = "the console accepts no output"
# More than Linux keeps for a terminal, which is 64 KiB at most.
COMMANDS = 400
SAMPLES_MEANWHILE = 400
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
    tmp_path: Path, unit: str, is_stopped: bool
) -> None:
    console = HeldConsole(is_stopped=is_stopped)
    with (
        SteeredBioHarness() as device,
        console.program(run(tmp_path, device.port, unit), environment(tmp_path)) as agent,
    ):
        wait_until(lambda: pushed(tmp_path) > 0)
        for _ in range(COMMANDS):
            ask(tmp_path, "resume", unit)
        wait_until(lambda: not console.takes_output)
        # liblsl's threads have to answer, and say so.
        ecg = inlet(naming.source_id(DeviceIdentity("zephyr", unit), "ecg"))
        received: list[float] = []
        wait_until(lambda: pull(ecg, received) > SAMPLES_MEANWHILE)
        ask(tmp_path, "resume", unit)
        wait_until(lambda: HELD in log(tmp_path))
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
    tmp_path: Path, unit: str, number: signal.Signals
) -> None:
    console = HeldConsole(is_stopped=True)
    absent = run(tmp_path, str(tmp_path / "ttyUSB9"), unit)
    with console.program(absent, environment(tmp_path)) as agent:
        wait_until((tmp_path / CONTROL_FILE).exists)
        agent.send_signal(number)
        assert agent.wait(DEADLINE_S) == 0
        assert not console.takes_output


@pytest.mark.seam
def test_a_released_console_shows_all_that_was_said_meanwhile_and_the_last_lines(
    tmp_path: Path, unit: str
) -> None:
    console = HeldConsole(is_stopped=True)
    absent = run(tmp_path, str(tmp_path / "ttyUSB9"), unit)
    with console.program(absent, environment(tmp_path)) as agent:
        wait_until((tmp_path / CONTROL_FILE).exists)
        for _ in range(20):
            ask(tmp_path, "resume", unit)
        console.release()
        wait_until(lambda: console.shown.count("command='resume'") == 20)
        ask(tmp_path, "stop", unit)
        assert agent.wait(DEADLINE_S) == 0
        wait_until(lambda: "command='stop'" in console.shown)
    # What liblsl says, which says it by itself, comes the same way.
    assert ".cpp:" in console.shown
    assert "Press Ctrl-C to end it." in console.shown
    assert "Traceback" not in console.shown


# A log file on a disk that hangs: a FIFO that nobody reads takes as little.
LINES, PADDING = 4000, "x" * 400
HUNG = "the log file accepts no output"
LOG = structlog.stdlib.get_logger("biosensor_gateway.test")
# What it logs must come to the console while the file is held, and then it has to end.
PROGRAM = """
import sys, time
from pathlib import Path
import structlog
from biosensor_gateway.system.logs import HELD_AFTER_S
from biosensor_gateway.system.logs import configure_logs
from biosensor_gateway.settings.models import LogSettings

configure_logs(LogSettings(), Path(sys.argv[1]))
log = structlog.stdlib.get_logger("biosensor_gateway.test")
for number in range(400):
    log.info("filling", number=number, padding="x" * 400)
time.sleep(HELD_AFTER_S + 0.5)
for number in range(3):
    log.info("meanwhile", number=number)
"""


@pytest.fixture
def fifo(tmp_path: Path) -> Path:
    path = tmp_path / LOG_FILE_NAME
    os.mkfifo(path)
    return path


@pytest.fixture
def unread(fifo: Path) -> Generator[int]:
    """The FIFO, open for reading."""
    descriptor = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    yield descriptor
    os.close(descriptor)


def test_the_console_goes_on_and_says_so_and_the_process_ends(fifo: Path, unread: int) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(fifo.parent)],
        stderr=subprocess.PIPE,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    assert ended.returncode == 0
    lines = ended.stderr.splitlines()
    assert sum("meanwhile" in line for line in lines) == 3
    assert sum("filling" in line for line in lines) == 400
    assert ended.stderr.count(HUNG) == 1
    assert len(lines) == 404
    assert select.select([unread], [], [], 0)[0]


def test_what_did_not_fit_is_counted_in_its_place(
    fifo: Path,
    unread: int,
    logging_as_before: None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    del logging_as_before
    # On a starved machine its own line about the held file would be among those that are missing.
    monkeypatch.setattr(logs, "HELD_AFTER_S", math.inf)
    configure_logs(LogSettings(), fifo.parent)
    for number in range(LINES):
        LOG.info("filling", number=number, padding=PADDING)
    read = bytearray()

    def has_all() -> bool:
        if select.select([unread], [], [], 0)[0]:
            read.extend(os.read(unread, 1 << 16))
        return b"missing" in read and read.endswith(b"\n")

    wait_until(has_all)
    LOG.info("again")
    wait_until(lambda: has_all() and b"again" in read)
    records: list[dict[str, Any]] = [json.loads(line) for line in read.splitlines()]
    came = [record["number"] for record in records if record["event"] == "filling"]
    assert came == list(range(len(came)))
    notice, again = [record for record in records if record["event"] != "filling"]
    missing = re.fullmatch(
        r"(\d+) lines are missing here: the log file accepted no output", notice["event"]
    )
    assert missing is not None
    assert int(missing[1]) == LINES - len(came) > 0
    assert (notice["level"], again["event"]) == ("warning", "again")


def test_a_file_that_does_not_open_is_one_that_cannot_be_written(fifo: Path) -> None:
    with pytest.raises(ConfigError, match="cannot write the log file in") as caught:
        configure_logs(LogSettings(), fifo.parent)
    assert caught.value.reason is ConfigReason.UNREADABLE
    assert "does not open within" in str(caught.value)
    # The disk answers at last; the file must not stay open.
    reading = os.open(fifo, os.O_RDONLY | os.O_NONBLOCK)
    for thread in [each for each in threading.enumerate() if each.name == "opens the log file"]:
        thread.join(DEADLINE_S)
    os.close(reading)


def test_a_trial_in_a_held_terminal_ends(tmp_path: Path) -> None:
    console = HeldConsole(is_stopped=True)
    command = [sys.executable, "-m", "biosensor_gateway.cli", "try", "--no-open"]
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    with console.program([*command, "--folder", str(tmp_path / "out")], environment) as program:
        wait_until(lambda: list(tmp_path.glob("biosensor-try-*")), "it begins")
        # It comes to its first sentence, which waits for the terminal.
        time.sleep(1.0)
        program.send_signal(signal.SIGTERM)
        assert program.wait(DEADLINE_S) == 1
    assert list(tmp_path.glob("biosensor-try-*")) == []
