"""Events of one device: what is said when, and with which counts."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any

import pylsl
import pytest

from biosensor_common.quantities import ChannelRole, ContentType, Unit
from biosensor_common.spec import DeviceIdentity, DeviceInfo, SensorSpec
from biosensor_common.table import channels, raw
from biosensor_gateway.devices.registry import declaration, declaration_names
from biosensor_gateway.streaming.events import EventKind
from biosensor_gateway.streaming.events.announcer import Announcer
from biosensor_gateway.streaming.events.device import (
    SETTLE_S,
    ContactWatch,
    DeviceEvents,
    Gap,
    GapWatch,
)
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.streaming.stages import RESUME_GUARD_S

TESTS = Path(__file__).parents[1]
DEVICE_S = 8.2e8
H10 = "polar_h10"
CONTACT = ChannelRole.CONTACT


class NotedAnnouncer(Announcer):
    """Notes what is announced, on its way into the outlet."""

    def __init__(self) -> None:
        self.noted: list[dict[str, Any]] = []
        super().__init__(0.0, dict)
        self.noted.clear()

    def announce(
        self, kind: EventKind, facts: Mapping[str, object], at: float | None = None
    ) -> None:
        super().announce(kind, facts, at)
        self.noted.append({"event": kind.value, **facts, **({} if at is None else {"at": at})})

    def take(self) -> list[dict[str, Any]]:
        """Return what was announced since; each of the only device."""
        noted, self.noted = self.noted, []
        assert {(each.pop("sensor"), each.pop("unit")) for each in noted} <= {(H10, "U1")}
        return noted


@pytest.fixture
def announcer() -> Generator[NotedAnnouncer]:
    made = NotedAnnouncer()
    yield made
    asyncio.run(made.end())


@pytest.fixture
def sink() -> Generator[DeviceSink]:
    made = DeviceSink(DeviceIdentity(H10, "U1"), declaration(H10))
    yield made
    made.close()


@pytest.fixture
def events(sink: DeviceSink, announcer: NotedAnnouncer) -> DeviceEvents:
    return sink.follow(announcer)


def opened(sink: DeviceSink, announcer: NotedAnnouncer) -> None:
    sink.open(DeviceInfo(), {"ecg": 130.0, "acc": 50.0})
    announcer.take()


@pytest.mark.nightly
def test_connections_are_counted_and_tell_the_firmware(
    sink: DeviceSink, events: DeviceEvents, announcer: NotedAnnouncer
) -> None:
    sink.open(DeviceInfo(firmware_version="3.3.1"), {"ecg": 130.0, "acc": 50.0})
    events.dropped("silent")
    sink.open(DeviceInfo(), {"ecg": 130.0, "acc": 50.0})
    assert announcer.take() == [
        {"event": "connected", "connection": 1, "firmware_version": "3.3.1"},
        {"event": "disconnected", "reason": "silent"},
        {"event": "connected", "connection": 2},
    ]


@pytest.mark.nightly
def test_what_a_device_decides_is_announced_when_it_changes(
    sink: DeviceSink, announcer: NotedAnnouncer, events: DeviceEvents
) -> None:
    assert sink.observer is events
    sink.open(DeviceInfo(serial_number="A", firmware_version="1"), {"acc": 50.0})
    sink.open(DeviceInfo(serial_number="A", firmware_version="2"), {"acc": 200.0})
    changed = [each for each in announcer.take() if each["event"] == "settings_changed"]
    assert changed == [
        {
            "event": "settings_changed",
            "changes": {"acc.rate_hz": (50.0, 200.0), "firmware_version": ("1", "2")},
        }
    ]


@pytest.mark.nightly
def test_participant_and_label_are_said_where_they_are_set(announcer: NotedAnnouncer) -> None:
    sink = DeviceSink(DeviceIdentity(H10, "U1", "p01", "left"), declaration(H10))
    events = sink.follow(announcer)
    events.reanchored("below", 1.23456789)
    assert announcer.noted == [
        {
            "event": "clock_reanchored",
            "sensor": H10,
            "unit": "U1",
            "participant": "p01",
            "label": "left",
            "cause": "below",
            "seconds": 1.234568,
        }
    ]


@pytest.mark.nightly
@pytest.mark.usefixtures("events")
def test_jumps_of_the_clock_are_announced(sink: DeviceSink, announcer: NotedAnnouncer) -> None:
    opened(sink, announcer)
    sink.restart_clock()
    assert announcer.take() == []
    sink.observe(DEVICE_S, pylsl.local_clock())
    sink.observe(DEVICE_S - 3600, pylsl.local_clock())
    sink.restart_clock()
    (jump, restart) = announcer.take()
    assert (jump["cause"], restart["cause"]) == ("device_backward", "device_restarted")
    assert jump["seconds"] == pytest.approx(3600, abs=1.0)
    assert "seconds" not in restart


@pytest.mark.nightly
@pytest.mark.usefixtures("events")
def test_a_storm_of_jumps_is_a_handful_of_events(
    sink: DeviceSink, announcer: NotedAnnouncer
) -> None:
    opened(sink, announcer)
    now = pylsl.local_clock()
    for number in range(500):
        sink.observe(DEVICE_S + 3600.0 * (number % 2), now + 0.01 * number)
    sink.close()
    told = [event.get("times", 1) for event in announcer.take()]
    assert len(told) <= 5
    assert sum(told) == sink.clock_state.reanchors == 499


@pytest.mark.nightly
@pytest.mark.usefixtures("events")
def test_on_and_off_body_are_announced_when_they_change(
    sink: DeviceSink, announcer: NotedAnnouncer
) -> None:
    opened(sink, announcer)
    now = pylsl.local_clock()
    for index, contact in enumerate([1.0, 1.0, 0.0, 0.0, 1.0]):
        sink.emit_at("quality", [[contact]], [now + index])
    assert announcer.take() == [
        {"event": "on_body", "channel": "contact", "at": now},
        {"event": "off_body", "channel": "contact", "at": now + 2},
        {"event": "on_body", "channel": "contact", "at": now + 4},
    ]


@pytest.mark.nightly
def test_of_a_pause_nothing_is_said_that_was_measured(
    sink: DeviceSink, announcer: NotedAnnouncer, events: DeviceEvents
) -> None:
    opened(sink, announcer)
    sink.emit_at("quality", [[1.0]], [pylsl.local_clock()])
    announcer.take()
    sink.pause()
    for contact in (0.0, 1.0, 0.0):
        now = pylsl.local_clock()
        sink.emit_at("quality", [[contact]], [now])
        sink.emit_at("ecg", [1.0], [now])
        sink.lost("ecg", 73)
    events.dropped("lost")
    events.tick(pylsl.local_clock() + 60)
    sink.open(DeviceInfo(), {"ecg": 130.0, "acc": 50.0})
    events.tick(pylsl.local_clock() + 60)
    sink.resume()
    said = announcer.take()
    assert [each["event"] for each in said] == ["paused", "disconnected", "connected", "resumed"]
    assert said[-1]["send_from"] == pytest.approx(pylsl.local_clock() + RESUME_GUARD_S, abs=0.5)
    # What was told before is news again.
    sink.emit_at("quality", [[1.0]], [pylsl.local_clock() + 2 * RESUME_GUARD_S])
    assert [each["event"] for each in announcer.take()] == ["on_body"]
    events.tick(pylsl.local_clock() + 60)
    assert announcer.take() == []


@pytest.mark.nightly
def test_a_pause_ends_a_gap_and_a_device_that_is_away_then_begins_one(
    sink: DeviceSink, announcer: NotedAnnouncer, events: DeviceEvents
) -> None:
    opened(sink, announcer)
    sink.emit_at("ecg", [1.0], [pylsl.local_clock()])
    events.dropped("lost")
    announcer.take()
    sink.pause()
    end, paused = announcer.take()
    assert (end["event"], end["paused"], end["lost"]) == ("gap_end", True, {})
    assert (paused["event"], paused["at"]) == ("paused", end["at"])
    sink.resume()
    resumed, start = announcer.take()
    assert (resumed["event"], start["event"]) == ("resumed", "gap_start")
    assert start["at"] == pytest.approx(resumed["send_from"], abs=1e-6)


@pytest.mark.nightly
def test_a_pause_from_before_the_start_is_announced_as_such(
    sink: DeviceSink, announcer: NotedAnnouncer
) -> None:
    sink.pause()
    sink.follow(announcer)
    assert announcer.take() == [{"event": "paused", "kept": True}]


@pytest.mark.nightly
def test_a_broken_connection_is_a_gap_with_all_that_is_missing(
    sink: DeviceSink, announcer: NotedAnnouncer, events: DeviceEvents
) -> None:
    opened(sink, announcer)
    now = pylsl.local_clock()
    sink.emit_at("ecg", [1.0], [now - 5.0])
    sink.emit_at("acc", [[0.0, 0.0, 1.0]], [now - 5.5])
    events.dropped("lost")
    # A connection that brings nothing leaves it open.
    sink.open(DeviceInfo(), {"ecg": 130.0, "acc": 50.0})
    events.dropped("silent")
    sink.open(DeviceInfo(), {"ecg": 130.0, "acc": 50.0})
    assert [each for each in announcer.take() if "gap" in each["event"]] == [
        {"event": "gap_start", "at": now - 5.0}
    ]
    sink.lost("ecg", 600)
    sink.emit_at("ecg", [1.0], [now - 0.1])
    events.tick(pylsl.local_clock())
    sink.lost("acc", 250)
    sink.emit_at("acc", [[0.0, 0.0, 1.0]], [now])
    events.tick(pylsl.local_clock())
    assert announcer.take() == []
    events.tick(pylsl.local_clock() + SETTLE_S)
    assert announcer.take() == [
        {"event": "gap_end", "at": now - 0.1, "lost": {"ecg": 600, "acc": 250}}
    ]


def gaps(watch: GapWatch, now: float) -> list[Gap]:
    return list(watch.tick(now))


def test_before_the_first_sample_there_is_no_gap() -> None:
    watch = GapWatch()
    assert list(watch.interrupted()) == []
    watch.sampled("ecg", 10.0, 10.5, now=10.6)
    assert gaps(watch, 100.0) == []


def test_losses_within_a_connection_are_one_gap_for_all_streams() -> None:
    watch = GapWatch()
    watch.sampled("ecg", 9.0, 10.0, now=10.0)
    watch.lost("ecg", 63, since=10.0)
    # Another stream's samples do not end it.
    watch.sampled("acc", 9.0, 10.2, now=10.3)
    watch.sampled("ecg", 10.5, 10.7, now=10.8)
    watch.lost("acc", 20, since=10.2)
    watch.sampled("acc", 10.6, 10.9, now=11.0)
    assert gaps(watch, 11.0) == [Gap(10.0)]
    assert gaps(watch, 10.8 + SETTLE_S - 0.01) == []
    (end,) = gaps(watch, 10.8 + SETTLE_S)
    assert (end.since, end.until, end.lost) == (10.0, 10.6, {"ecg": 63, "acc": 20})
    assert gaps(watch, 60.0) == []


def test_a_driver_may_count_losses_after_the_sample_behind_them() -> None:
    watch = GapWatch()
    watch.sampled("eeg", 10.0, 10.0, now=10.0)
    watch.sampled("eeg", 10.5, 10.5, now=10.5)
    watch.lost("eeg", 63, since=10.0)
    watch.sampled("eeg", 10.508, 10.508, now=10.51)
    start, end = [*gaps(watch, 10.6), *gaps(watch, 20.0)]
    assert (start.since, end.since, end.until) == (10.0, 10.0, 10.508)


def test_an_interruption_ends_what_was_missing_before() -> None:
    watch = GapWatch()
    watch.sampled("ecg", 9.0, 10.0, now=10.0)
    watch.lost("ecg", 63, since=10.0)
    assert [(gap.since, gap.until) for gap in watch.interrupted()] == [
        (10.0, None),
        (10.0, 10.0),
        (10.0, None),
    ]
    assert list(watch.interrupted()) == []


def test_a_gap_never_begins_before_the_resumption() -> None:
    watch = GapWatch()
    watch.sampled("ecg", 9.0, 10.0, now=10.0)
    watch.go_on(50.0)
    watch.lost("ecg", 63, since=10.0)
    assert gaps(watch, 51.0) == [Gap(50.0)]


def test_channels_that_tell_wear_are_those_of_the_declarations() -> None:
    found = {name: ContactWatch(declaration(name)).channel for name in declaration_names()}
    said = {
        row["sensor"]: channel[0]
        for path in TESTS.glob("*/streams.json")
        for row in json.loads(path.read_text(encoding="utf-8"))
        for channel in row["channels"]
        if channel[2:] == ["contact"]
    }
    assert said["empatica_e4"] == "worn"
    assert found == {name: said.get(name, "") for name in declaration_names()}


def test_contact_is_followed_wherever_a_sensor_of_another_package_tells_it() -> None:
    skin = (*channels("mmHg", "pressure"), *channels(Unit.BOOLEAN, "on", roles=[CONTACT]))
    stream = raw("cuff", ContentType.STATUS, skin, 10.0)
    watch = ContactWatch(SensorSpec("another", "Another", "", "", (stream,)))
    assert watch.channel == "on"
    assert list(watch.changes("quality", [[0.0, 0.0]], [1.0])) == []
    assert list(watch.changes("cuff", [[0.0, 1.0]], [2.0])) == [(True, 2.0)]


def test_an_unknown_wear_is_no_change() -> None:
    watch = ContactWatch(declaration("zephyr"))
    nan = float("nan")
    rows = [[value, 9.0, 9.0, 9.0, 9.0, 9.0] for value in (nan, 1.0, nan, 1.0, 0.0)]
    told = list(watch.changes("quality", rows, [0.0, 1.0, 2.0, 3.0, 4.0]))
    assert told == [(True, 1.0), (False, 4.0)]
    assert list(watch.changes("hr", [[0.0]], [5.0])) == []
