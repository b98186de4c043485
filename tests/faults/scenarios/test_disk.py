"""The disk is full, or the state folder read-only: streaming goes on, and it is said."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import pylsl
import pytest

from biosensor_common.errors import ConfigError
from biosensor_gateway.agent import status_file
from tests.faults.agent import AgentProcess
from tests.faults.expectations import regular_streams, source, steady_streams
from tests.faults.recorder import Recorder
from tests.faults.scenarios.figures import Record
from tests.faults.scenarios.ledger import TruthLedger
from tests.faults.scenarios.namespace import MountNamespace
from tests.faults.scenarios.stage import (
    channels_of,
    is_streaming,
    lab_of,
    log_path,
    wait_until,
    write_settings,
)
from tests.rigs.lab_client import LabProcess
from tests.rigs.stopwatch import Stopwatch

SENSORS = ("zephyr", "empatica_e4")
SAID_LIMIT_S = 2.0
# Of that, Python and its libraries take their part to start.
BUSY = 3
HOLD_S = 6.0
# A BioHarness sends once a second, a wristband its slow signals six samples at a time.
LAG_S = 3.0
STATUS_TEXT = "the status file cannot be written"
LOG_TEXT = "cannot write the log file"
BLOCK = 4096

pytestmark = [pytest.mark.system, pytest.mark.timeout(240)]


def keep_console(folder: Path, elsewhere: Path) -> None:
    """What an agent prints goes to no disk of its own."""
    (folder / "console.txt").symlink_to(elsewhere / "console.txt")


def fill(folder: Path) -> Path:
    """Leave no room on the file system; return the file that takes it."""
    log, ballast = log_path(folder), folder / "ballast"
    with log.open("ab") as file:
        # Else the log would go on in what is left of its last block.
        file.write(b"\n" * (-log.stat().st_size % BLOCK))
    with suppress(OSError), ballast.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(BLOCK))
    return ballast


def lost(lab: LabProcess, recorder: Recorder, since_s: float) -> int:
    """Samples of regular streams that were sent after a time and did not come."""
    streams = [(name, each) for name in SENSORS for each in regular_streams(name)]
    came = {stream: recorder.recorded(source(*stream)).since(since_s) for stream in streams}
    # Later, so that all that came is in it.
    truths = {name: lab.truth(name) for name in SENSORS}
    count = 0
    for name, data_name in streams:
        ledger = TruthLedger()
        ledger.settle(came[name, data_name], truths[name][data_name])
        assert ledger.received
        count += ledger.lost
    return count


def newest_s(recorder: Recorder) -> float:
    """Up to when all streams have come."""
    return min(
        recorder.newest(source(name, each)) for name in SENSORS for each in steady_streams(name)
    )


def is_reported(folder: Path) -> Callable[[], bool]:
    """Whether the status file of an agent is there and new."""

    def holds() -> bool:
        with suppress(ConfigError):
            written = status_file.read_status(folder)["written"]
            return time.time() - written < status_file.STALE_AFTER_S / 2
        return False

    return holds


class FullDisk(NamedTuple):
    """Samples lost meanwhile, how long until it was said [s], and all that was said."""

    lost: int
    said_s: float
    console: str


@pytest.fixture(scope="module")
def full_disk(tmp_path_factory: pytest.TempPathFactory) -> FullDisk:
    """An agent whose disk was full for a while, and had room again in the end."""
    outside = tmp_path_factory.mktemp("full")
    state = outside / "state"
    state.mkdir()
    mount = f"mount -t tmpfs -o size=1m tmpfs {state}"
    with lab_of(SENSORS, outside) as lab, MountNamespace(mount) as namespace:
        folder = namespace.path(state)
        keep_console(folder, outside)
        settings = write_settings(outside, lab, {name: name for name in SENSORS})
        with (
            AgentProcess(folder, *settings, environment=lab.environment) as agent,
            Recorder(channels_of(SENSORS)) as recorder,
        ):
            wait_until(lambda: is_streaming(agent) and newest_s(recorder), "streaming devices")
            begin_s, watch = pylsl.local_clock(), Stopwatch()
            ballast = fill(folder)
            wait_until(lambda: STATUS_TEXT in agent.console(), "a word about it")
            said_s = watch.free_s()
            time.sleep(HOLD_S)
            count = lost(lab, recorder, begin_s)
            assert newest_s(recorder) > begin_s + HOLD_S - LAG_S
            ballast.unlink()
            wait_until(is_reported(folder), "a status file once there is room again")
        return FullDisk(count, said_s, agent.console())


def test_a_full_disk_stops_no_stream(full_disk: FullDisk, figures: Record) -> None:
    figures("disk full", "samples lost", "0", str(full_disk.lost))
    assert full_disk.lost == 0


def test_a_full_disk_is_said(full_disk: FullDisk, figures: Record) -> None:
    figures("disk full", "said after", f"<= {SAID_LIMIT_S:g} s", f"{full_disk.said_s:.1f} s")
    assert full_disk.said_s <= BUSY * SAID_LIMIT_S


def test_a_full_disk_is_said_in_a_sentence(full_disk: FullDisk) -> None:
    assert full_disk.console.count(STATUS_TEXT) == 1
    assert full_disk.console.count(LOG_TEXT) == 1
    assert "Traceback" not in full_disk.console


def test_a_read_only_folder_stops_no_stream(tmp_path: Path, figures: Record) -> None:
    state = tmp_path / "state"
    state.mkdir()
    keep_console(state, tmp_path)
    mounts = (f"mount --bind {state} {state}", f"mount -o remount,ro,bind {state}")
    with lab_of(SENSORS, tmp_path) as lab, MountNamespace(*mounts) as namespace:
        settings = write_settings(tmp_path, lab, {name: name for name in SENSORS})
        watch = Stopwatch()
        with (
            AgentProcess(namespace.path(state), *settings, environment=lab.environment) as agent,
            Recorder(channels_of(SENSORS)) as recorder,
        ):
            wait_until(lambda: LOG_TEXT in agent.console(), "a word about it")
            said_s = watch.free_s()
            wait_until(lambda: newest_s(recorder), "streaming devices")
            begin_s = pylsl.local_clock()
            time.sleep(HOLD_S)
            count = lost(lab, recorder, begin_s)
            assert newest_s(recorder) > begin_s + HOLD_S - LAG_S
        console = agent.console()
    figures("log folder read-only", "samples lost", "0", str(count))
    figures(
        "log folder read-only", "said after the start", f"<= {SAID_LIMIT_S:g} s", f"{said_s:.1f} s"
    )
    assert count == 0
    assert said_s <= BUSY * SAID_LIMIT_S
    assert STATUS_TEXT in console
    assert "Traceback" not in console
