"""What a killed run knew of its streams is there for the next one, and for nobody else."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.agent import FRESH_S, STREAMS_FILE, KnownStreams
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.sink import DeviceSink

BELT = "vernier_respiration_belt"
INFO = DeviceInfo(model="GDX-RB", serial_number="0K2", firmware_version="2.4")
RATES = {"bpm": 0.1, "force": 10.0}
UNITS = ("one", "two")

MakeSinks = Callable[..., list[DeviceSink]]


@pytest.fixture
def sinks(unit: str) -> Generator[MakeSinks]:
    made: list[DeviceSink] = []

    def make(participant: str = "") -> list[DeviceSink]:
        new = [
            DeviceSink(DeviceIdentity(BELT, f"{unit}-{each}", participant), declaration(BELT))
            for each in UNITS
        ]
        made.extend(new)
        return new

    yield make
    for sink in made:
        sink.close()


@pytest.fixture
def killed(tmp_path: Path, sinks: MakeSinks) -> Path:
    """Folder of a run whose first device was connected, and that was killed."""
    connected, absent = sinks()
    known = KnownStreams(tmp_path, lambda: [connected, absent])
    known.store()
    connected.open(INFO, RATES)
    known.store()
    status_file.write_status(tmp_path, {})
    connected.close()
    return tmp_path


def test_only_what_was_connected_is_expected(killed: Path, sinks: MakeSinks) -> None:
    again, absent = sinks()
    KnownStreams(killed, lambda: [again, absent]).reopen()
    assert (again.info, again.told_rates) == (INFO, RATES)
    assert set(again.nominal_rates.values()) >= {10.0}
    assert absent.counters == {}


def test_what_comes_at_once_waits_for_receivers_who_return(killed: Path, sinks: MakeSinks) -> None:
    again, _ = both = sinks()
    KnownStreams(killed, lambda: both).reopen()
    again.emit_at("force", [1.0, 2.0], [again.clock(), again.clock()])
    force = next(each for name, each in again.counters.items() if name.endswith("-force"))
    assert (force.pushed, force.waited) == (0, 2)


def test_what_was_expected_is_kept_for_the_run_after(killed: Path, sinks: MakeSinks) -> None:
    known = KnownStreams(killed, sinks)
    known.reopen()
    known.store()
    again, _ = later = sinks()
    KnownStreams(killed, lambda: later).reopen()
    assert again.info == INFO


def test_another_person_is_not_expected(killed: Path, sinks: MakeSinks) -> None:
    others = sinks(participant="p02")
    KnownStreams(killed, lambda: others).reopen()
    assert all(sink.counters == {} for sink in others)


def test_nothing_is_expected_after_a_clean_end(killed: Path, sinks: MakeSinks) -> None:
    again = sinks()
    KnownStreams(killed, lambda: again).remove()
    status_file.remove_status(killed)
    KnownStreams(killed, lambda: again).reopen()
    assert all(sink.counters == {} for sink in again)
    assert list(killed.iterdir()) == []


def test_nothing_is_expected_of_a_run_that_is_long_dead(killed: Path, sinks: MakeSinks) -> None:
    died_s = time.time() - FRESH_S - 1
    os.utime(killed / status_file.STATUS_FILE, (died_s, died_s))
    again = sinks()
    KnownStreams(killed, lambda: again).reopen()
    assert all(sink.counters == {} for sink in again)


@pytest.mark.parametrize("text", ["", "[", "{}", '[{"identity": 1}]', '[{"rates": {"a": NaN}}]'])
def test_a_damaged_file_is_said_and_nothing_is_expected(
    killed: Path, sinks: MakeSinks, text: str
) -> None:
    (killed / STREAMS_FILE).write_text(text)
    again = sinks()
    with capture_logs() as logs:
        KnownStreams(killed, lambda: again).reopen()
    (said,) = logs
    assert said["log_level"] == "warning"
    assert str(killed / STREAMS_FILE) in said["event"]
    assert all(sink.counters == {} for sink in again)


def test_a_folder_that_cannot_be_written_is_said_once(tmp_path: Path, sinks: MakeSinks) -> None:
    folder = tmp_path / "file"
    folder.touch()
    first, second = both = sinks()
    known = KnownStreams(folder, lambda: both)
    with capture_logs() as logs:
        for sink in (first, second):
            sink.open(INFO, RATES)
            known.store()
    assert [each["log_level"] for each in logs] == ["warning"]
