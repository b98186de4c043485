"""Two people wear virtual devices of one kind: what is known of one is never said of the other."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from biosensor_common.refusal import LATELY_S, Refusal, Refusals
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.agent import status_file
from biosensor_gateway.agent.agent import problems_of, snapshot
from biosensor_gateway.agent.device_set import Device, DeviceSet
from biosensor_gateway.agent.pauses import PauseCommands, load_pauses
from biosensor_gateway.agent.selection import holders, unique_names
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.demo.virtual_devices import simulated_settings
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.page.routes.devices import last_lines
from biosensor_gateway.page.routes.recording import Story
from biosensor_gateway.recording.recorder.result import By, LocalStatus
from biosensor_gateway.recording.recorder.streams import expected_devices
from biosensor_gateway.recording.xdf.findings import Level
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings
from biosensor_gateway.streaming import outlets
from biosensor_gateway.streaming.events import EventKind
from biosensor_gateway.streaming.events.announcer import device_facts
from biosensor_gateway.streaming.room import Room
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.device_log import names_in_log
from biosensor_gateway.system.logs import configure_logs, flush_logs
from tests.gateway.test_new_file import NoDriver
from tests.rigs.kept_logging import kept_logging
from tests.rigs.memory_links import MemoryOutlet
from tests.xdf.checking import codes, text_of
from tests.xdf.test_participants import judged

FIRST, SECOND = (DeviceIdentity("polar_h10", "virtual", each) for each in ("P01", "P02"))
OTHER = DeviceIdentity("zephyr", "virtual", "P01")


def device(identity: DeviceIdentity) -> Device:
    sink = DeviceSink(identity, declaration(identity.sensor))
    sink.open(DeviceInfo(), {})
    return Device(Supervisor(NoDriver, sink), sink)


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch) -> list[Device]:
    monkeypatch.setattr(outlets, "LslOutlet", MemoryOutlet)
    return [device(FIRST), device(SECOND)]


def test_names_are_those_of_before_where_they_are_unique() -> None:
    assert unique_names([FIRST, OTHER]) == ["polar_h10/virtual", "zephyr/virtual"]
    names = ["polar_h10/virtual (P01)", "polar_h10/virtual (P02)", "zephyr/virtual"]
    assert unique_names([FIRST, SECOND, OTHER]) == names
    for name, each in zip(names, (FIRST, SECOND, OTHER), strict=True):
        assert holders(name, [FIRST, SECOND, OTHER]) == (each,)
    # A recording of before had one name for both.
    assert holders("polar_h10/virtual", [FIRST, SECOND, OTHER]) == (FIRST, SECOND)
    assert holders("polar_h10/virtual (P02)", [FIRST]) == ()


def test_what_is_wrong_with_one_is_told_of_that_one(two: list[Device]) -> None:
    two[1].sink.left_out(3, why="it is not known")
    named = dict(zip(unique_names([FIRST, SECOND]), two, strict=True))
    (told,) = problems_of(named, Refusals(), [], LATELY_S).items()
    assert told[0] == "polar_h10/virtual (P02)"


def test_both_take_room(two: list[Device]) -> None:
    entries = [DeviceSettings(sensor="polar_h10", unit=unit) for unit in ("a", "b")]
    devices = DeviceSet(dict(zip(entries, two, strict=True)), Room(two[0].streams))
    devices.make_room()
    assert devices.with_room == two[:1]


def heartbeat(at: float, first: str, second: str) -> dict[str, object]:
    states = dict(zip(unique_names([FIRST, SECOND]), (first, second), strict=True))
    return {"event": "heartbeat", "devices": states, "lsl_time": at}


def test_a_recording_tells_who_was_paused() -> None:
    paused = {"event": EventKind.PAUSED, **device_facts(SECOND), "lsl_time": 1012.0}
    events: list[object] = [heartbeat(1001.0, "streaming", "streaming"), paused]
    report = judged("group1", FIRST, SECOND, events=events)
    assert codes(report, Level.WARNING) == {("away", "")}
    assert text_of(report, "away") == "polar_h10/virtual of P02 was paused from 12.0 s to the end"


def test_a_recording_without_one_of_them_says_so() -> None:
    events: list[object] = [heartbeat(1001.0, "streaming", "streaming")]
    report = judged("P01", FIRST, events=events)
    assert codes(report, Level.ERROR) == {("left-out", "")}
    assert text_of(report, "left-out").startswith("the agent also had polar_h10/virtual (P02)")


def test_the_recorder_waits_for_the_one_that_streams(tmp_path: Path, two: list[Device]) -> None:
    status = snapshot(two).model_dump()
    status["devices"][0]["state"] = "streaming"
    status_file.write_status(tmp_path, status)
    first, second = expected_devices(GatewaySettings(), tmp_path)
    assert not first.away
    assert second.away.startswith("P02's ")


def test_the_page_tells_who_is_back() -> None:
    story = Story()

    def told(*states: str) -> list[str]:
        identities = (FIRST, SECOND)
        facts: list[dict[str, object]] = [
            {"sensor": each.sensor, "unit": each.unit, "participant": each.participant,
             "label": "", "state": state, "paused": False, "error": None,
             "since": time.time(), "streams": {}}
            for each, state in zip(identities, states, strict=True)
        ]  # fmt: skip
        standing = LocalStatus(by=By.GATEWAY, recording=True, file=Path("/a.xdf"), started=1.0)
        story.look(facts, standing)
        return story.notes

    assert told("enabling", "enabling") == []
    (note,) = told("streaming", "enabling")
    assert note.startswith("P01's ")
    assert len(told("streaming", "streaming")) == 2


async def test_the_pause_of_one_is_kept_while_another_is_resumed(
    tmp_path: Path, two: list[Device]
) -> None:
    nobody = device(DeviceIdentity("polar_h10", "virtual"))
    sinks = [nobody.sink, two[0].sink]
    commands = PauseCommands(tmp_path, lambda: sinks).commands
    await commands["pause"]({"device": "polar_h10/virtual (P01)"})
    assert [each.is_paused for each in sinks] == [False, True]
    await commands["resume"]({"device": "polar_h10/virtual"})
    assert [each.identity for each in load_pauses(tmp_path)] == [FIRST]
    again = [device(nobody.sink.identity).sink, device(FIRST).sink]
    PauseCommands(tmp_path, lambda: again)
    assert [each.is_paused for each in again] == [False, True]


@pytest.mark.usefixtures("two")
def test_the_log_tells_whose_device_it_is_about(tmp_path: Path) -> None:
    with kept_logging(), simulated_settings(["polar_h10@P01", "polar_h10@P02"]) as settings:
        configure_logs(settings.log, tmp_path)
        for entry, data_name in zip(settings.devices, ("hr", "ibi"), strict=True):
            sink = Device.from_settings(entry).sink
            sink.open(DeviceInfo(), {})
            # Which is refused, as it has two values too many.
            sink.emit_at(data_name, [[1.0, 2.0, 3.0]], [sink.clock()])
        flush_logs()
    for identity, data_name in ((FIRST, "hr"), (SECOND, "ibi")):
        (line,) = last_lines(tmp_path, identity).lines
        assert f"data {data_name}" in line.sentence
    # A unit of the settings is that of one device, so pseudonyms stay out of the log.
    assert names_in_log(FIRST) == {"sensor": "polar_h10", "unit": "virtual"}


def test_refusals_last_until_the_next_heartbeat() -> None:
    now = 0.0
    refusals = Refusals(clock=lambda: now)
    refusals.refuse(Refusal.GARBLED, 3)
    now = 45.0
    assert refusals.present == []
    assert len(refusals.within(60.0)) == 1
