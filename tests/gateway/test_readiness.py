"""Which devices are ready or absent, and which streams a killed run knew."""

from __future__ import annotations

import itertools
import os
import re
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from structlog.testing import capture_logs

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.agent import FRESH_S, STREAMS_FILE, KnownStreams
from biosensor_gateway.agent.device_states import State, absences, clock_time, names
from biosensor_gateway.agent.readiness import Readiness, steady_streams, wait_until_ready
from biosensor_gateway.devices.registry import declaration, sensor_title
from biosensor_gateway.streaming.sink import DeviceSink
from tests.faults import expectations

if TYPE_CHECKING:
    from tests.gateway.conftest import Outcome

# Which devices are ready, and which streams a killed run knew.

# When the devices of an agent count as ready.

Report = Callable[[int], list[dict[str, Any]]]
Run = Callable[..., "Outcome"]
DEADLINE_S = 30.0
SHORT_S = 3.0
EVERY_S = 0.1
ECG, BREATHING, ACC = (f"zephyr-1-{name}" for name in ("ecg", "breathing", "acc"))
STEADY = (ECG, BREATHING, ACC)


def device(sensor: str = "zephyr", **more: object) -> dict[str, Any]:
    known: dict[str, Any] = {
        "sensor": sensor,
        "unit": "1",
        "participant": "",
        "label": "",
        "state": "streaming",
        "error": None,
        "clock": None,
        "streams": {},
    }
    return known | more


def streams(count: int, *sources: str) -> dict[str, Any]:
    return {source: {"pushed": count, "waited": 0, "nominal_hz": 50.0} for source in sources}


@contextmanager
def reporting(state: Path, report: Report, process: Callable[[int], int] = lambda _: 1):  # noqa: ANN201 - a context
    """Report as an agent does, but ten times as often; ``report`` gets the report's number."""
    ended = threading.Event()

    def write() -> None:
        for number in itertools.count():
            status = {"written": time.time(), "process": process(number), "devices": report(number)}
            status_file.write_status(state, status)
            if ended.wait(EVERY_S):
                return

    writer = threading.Thread(target=write)
    writer.start()
    try:
        yield
    finally:
        ended.set()
        writer.join()


def missing(outcome: Readiness) -> list[tuple[str, tuple[str, ...], str]]:
    assert not outcome.ready
    return [(each.device, each.streams, each.why) for each in outcome.missing]


@pytest.mark.parametrize("name", expectations.SENSORS)
def test_waited_for_is_what_the_fault_suite_knows_to_be_steady(name: str) -> None:
    never = expectations.never_streams(name)
    absent: dict[str, Any] = {
        f"{name}-1-{each}": {"pushed": 0, "nominal_hz": 0.0} for each in never
    }
    described = device(name, streams=absent)
    expected = [f"{name}-1-{data}" for data in expectations.steady_streams(name)]
    assert list(steady_streams(described, frozenset())) == expected


@pytest.mark.nightly
def test_ready_is_when_all_counters_advance(state: Path) -> None:
    with reporting(state, lambda n: [device(streams=streams(n, *STEADY))]):
        outcome = wait_until_ready(state, DEADLINE_S)
    assert outcome.ready
    assert (outcome.devices, outcome.streams, outcome.missing) == (1, 3, ())


@pytest.mark.nightly
def test_a_state_alone_is_not_believed(state: Path) -> None:
    with reporting(state, lambda _: [device(streams=streams(4711, *STEADY))]):
        outcome = wait_until_ready(state, SHORT_S)
    why = "connected, but not all of its streams deliver samples"
    assert missing(outcome) == [("zephyr (1)", STEADY, why)]
    assert outcome.waited_s >= SHORT_S


@pytest.mark.nightly
def test_one_silent_stream_is_enough_and_is_named(state: Path) -> None:
    silent = streams(0, ACC)
    with reporting(state, lambda n: [device(streams=streams(n, ECG, BREATHING) | silent)]):
        outcome = wait_until_ready(state, SHORT_S)
        assert [streams for _, streams, _ in missing(outcome)] == [(ACC,)]
        # By data name or source_id, it need not be waited for.
        assert wait_until_ready(state, DEADLINE_S, ["acc"]).ready
        assert wait_until_ready(state, DEADLINE_S, [ACC]).ready


@pytest.mark.nightly
def test_a_stream_that_is_enabled_again_is_missing_until_it_flows(state: Path) -> None:
    error = "connected, but no data of acc for 6 s; enabling again"

    def report(number: int) -> list[dict[str, Any]]:
        flowing = streams(number, ECG, BREATHING) | streams(0, ACC)
        return [device(streams=flowing, state="enabling", error=error)]

    with reporting(state, report):
        assert missing(wait_until_ready(state, SHORT_S)) == [("zephyr (1)", (ACC,), error)]
        assert wait_until_ready(state, DEADLINE_S, ["acc"]).ready


@pytest.mark.nightly
def test_what_stopped_advancing_is_not_ready(state: Path) -> None:
    begun = time.monotonic()

    def report(number: int) -> list[dict[str, Any]]:
        stalled = min(number, 10)
        return [device(streams=streams(number, ECG, BREATHING) | streams(stalled, ACC)),
                device(unit="2")]  # fmt: skip

    with reporting(state, report):
        outcome = wait_until_ready(state, 12.0)
    assert time.monotonic() - begun >= 12.0
    assert (("zephyr (1)", (ACC,))) in [each[:2] for each in missing(outcome)]


@pytest.mark.nightly
def test_a_device_that_is_away_is_named_with_its_error(state: Path) -> None:
    away = device(unit="2", participant="p01", label="left", state="discovering",
                  error="COM7: there is no such port")  # fmt: skip
    with reporting(state, lambda n: [device(streams=streams(n, *STEADY)), away]):
        ((name, sources, why),) = missing(wait_until_ready(state, SHORT_S))
    assert name == "p01 zephyr left (2)"
    assert sources == tuple(f"p01@zephyr.left-{data}" for data in ("ecg", "breathing", "acc"))
    assert why == "discovering - COM7: there is no such port"


@pytest.mark.nightly
def test_a_connection_that_is_lost_is_not_ready_whatever_was_counted(state: Path) -> None:
    with reporting(state, lambda n: [device(streams=streams(n, *STEADY), state="connecting")]):
        ((_, _, why),) = missing(wait_until_ready(state, SHORT_S))
    assert why == "connecting"


@pytest.mark.nightly
def test_a_paused_device_is_not_ready(state: Path) -> None:
    with reporting(state, lambda _: [device(streams=streams(9, *STEADY), paused=True)]):
        ((_, _, why),) = missing(wait_until_ready(state, SHORT_S))
    assert "resume" in why


@pytest.mark.nightly
def test_a_strap_is_ready_by_what_waits_for_its_first_receiver(state: Path) -> None:
    def report(number: int) -> list[dict[str, Any]]:
        quality = {"pushed": 0, "waited": number, "nominal_hz": 0.0}
        return [device("ble_heart_rate", streams={"ble_heart_rate-1-quality": quality})]

    with reporting(state, report):
        assert wait_until_ready(state, DEADLINE_S).ready


@pytest.mark.nightly
def test_a_stream_that_the_settings_switched_off_is_not_waited_for(state: Path) -> None:
    def report(number: int) -> list[dict[str, Any]]:
        silent = {source: each | {"silent": True} for source, each in streams(0, STEADY[0]).items()}
        return [device(streams=streams(number, *STEADY[1:]) | silent)]

    with reporting(state, report):
        outcome = wait_until_ready(state, DEADLINE_S)
    assert (outcome.ready, outcome.streams) == (True, len(STEADY) - 1)


@pytest.mark.nightly
def test_another_agent_s_counts_are_not_compared(state: Path) -> None:
    """One that is restarted every time begins with a higher count, but never counts on."""
    with reporting(state, lambda n: [device(streams=streams(n, *STEADY))], process=lambda n: n + 1):
        assert [each[1] for each in missing(wait_until_ready(state, SHORT_S))] == [STEADY]


@pytest.mark.nightly
def test_without_an_agent_it_waits_and_says_so(state: Path) -> None:
    begun = time.monotonic()
    ((name, _, why),) = missing(wait_until_ready(state, 1.0))
    assert (name, time.monotonic() - begun >= 1.0) == ("", True)
    assert "no agent is running" in why


@pytest.mark.nightly
def test_an_agent_without_devices_is_never_ready(state: Path) -> None:
    with reporting(state, lambda _: []):
        ((_, _, why),) = missing(wait_until_ready(state, 1.0))
    assert "no enabled device" in why


@pytest.fixture
def away(state: Path) -> Generator[None]:
    with reporting(state, lambda _: [device(state="backoff", error="the [device] is busy")]):
        yield


@pytest.mark.nightly
@pytest.mark.usefixtures("away")
def test_the_command_says_what_is_missing_and_fails(run: Run) -> None:
    outcome = run("wait-ready", "--timeout", "1")
    assert (outcome.code, outcome.out) == (1, "")
    said = re.sub(r"\d+ s:", "1 s:", outcome.err, count=1)
    assert said == (
        "not ready after 1 s:\n- zephyr (1): backoff - the [device] is busy "
        f"(no samples of {', '.join(STEADY)})\n"
    )
    assert run("wait-ready", "--timeout", "-1").code == 2


# What a killed run knew of its streams is there for the next one, and for nobody else.
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


# What is said of a device that does not stream, and since when.
STRAP = sensor_title("polar_h10")


def absent(**changes: Any) -> dict[str, Any]:
    usual: dict[str, Any] = {
        "sensor": "polar_h10",
        "unit": "A1",
        "participant": "P03",
        "label": "",
        "state": "streaming",
        "paused": False,
        "error": None,
        "since": None,
        "streams": {"P03@polar_h10-ecg": {}},
    }
    return usual | changes


def at(hour: int, minute: int) -> float:
    today = datetime.now().astimezone()
    return today.replace(hour=hour, minute=minute, second=7, microsecond=0).timestamp()


def test_a_device_that_streams_is_not_named() -> None:
    assert absences([absent()]) == ()


def test_a_pause_is_named_with_its_person_and_its_time() -> None:
    (found,) = absences([absent(paused=True, since=at(14, 3))])
    assert found.sentence == f"P03's {STRAP} is paused since 14:03"
    assert (found.is_paused, found.is_partial) == (True, False)
    assert found.sources == {"P03@polar_h10-ecg"}


@pytest.mark.parametrize("state", [each for each in State if each is not State.STREAMING])
def test_every_other_state_is_told(state: State) -> None:
    (found,) = absences([absent(state=state.value, since=at(9, 5), error="it was refused")])
    assert found.sentence.startswith(f"P03's {STRAP} ")
    assert found.sentence.endswith(" since 09:05: it was refused")
    assert not found.is_partial


def test_of_one_that_streams_in_part_the_reason_is_told() -> None:
    (found,) = absences([absent(error="no data of acc")])
    assert found.sentence == f"P03's {STRAP} streams, but: no data of acc"
    assert (found.is_partial, found.sources) == (True, frozenset())


def test_an_agent_of_before_says_no_time() -> None:
    old = absent(state="connecting")
    del old["since"]
    (found,) = absences([old])
    assert found.sentence == f"P03's {STRAP} is not connected"


def test_two_of_a_name_are_told_apart() -> None:
    two = [absent(), absent(unit="B2"), absent(label="left"), absent(participant="")]
    assert names(two) == [f"P03 {STRAP} A1", f"P03 {STRAP} B2", f"P03 {STRAP} left", STRAP]


def test_a_time_of_another_day_has_its_date() -> None:
    yesterday = datetime.now().astimezone() - timedelta(days=1)
    assert clock_time(yesterday.timestamp()) == f"{yesterday:%Y-%m-%d %H:%M}"
    assert clock_time(at(7, 1), seconds=True) == "07:01:07"
