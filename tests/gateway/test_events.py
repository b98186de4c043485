"""Events of one device, and the stream that carries them."""

from __future__ import annotations

import asyncio
import json
import socket
import time
from collections.abc import AsyncGenerator, Callable, Generator, Mapping
from contextlib import asynccontextmanager, suppress
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn

import pylsl
import pytest
from pylsl.util import LostError
from structlog.testing import capture_logs

from biosensor_common import naming
from biosensor_common.errors import ConfigError
from biosensor_common.quantities import ChannelRole, ContentType, Unit
from biosensor_common.ros_clock import measure_clock_pair, read_clock_pair
from biosensor_common.spec import DeviceIdentity, DeviceInfo, SensorSpec
from biosensor_common.table import channels, raw
from biosensor_gateway.devices.registry import declaration, declaration_names
from biosensor_gateway.settings.file import load_settings
from biosensor_gateway.streaming import outlets
from biosensor_gateway.streaming.events import EventKind
from biosensor_gateway.streaming.events.announcer import (
    SETTLE_S,
    TICK_S,
    Announcer,
    ContactWatch,
    DeviceEvents,
    Gap,
    GapWatch,
)
from biosensor_gateway.streaming.outlets import Outlet, log_errors
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.streaming.stages import RESUME_GUARD_S
from biosensor_gateway.system.clock import LSL_CLOCK, Clock
from tests.rigs.gateway import inlet
from tests.rigs.polling import eventually

# Events of one device: what is said when, and with which counts.

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


# The stream of events: signs of life, stamps, and that it never harms the data.
SOURCE = naming.source_id(DeviceIdentity("gateway", socket.gethostname()), "events")
STATES = {"zephyr/1": "streaming"}


class Heard:
    """What a real inlet gets of the stream of events."""

    def __init__(self, reader: pylsl.StreamInlet) -> None:
        self._reader = reader
        self.events: list[tuple[dict[str, Any], float]] = []

    def pull(self) -> list[dict[str, Any]]:
        samples, stamps = self._reader.pull_chunk(timeout=0.0)
        texts = (row[0] for row in samples)
        self.events += zip(map(json.loads, texts), stamps, strict=True)
        return [event for event, _ in self.events]

    def kinds(self) -> list[str]:
        return [event["event"] for event in self.pull()]

    def has(self, kind: EventKind, count: int = 1) -> Callable[[], bool]:
        return lambda: self.kinds().count(kind.value) >= count


@asynccontextmanager
async def announcing(
    heartbeat_s: float,
    states: Callable[[], Mapping[str, str]] = lambda: STATES,
    clock: Clock = LSL_CLOCK,
) -> AsyncGenerator[Announcer]:
    announcer = Announcer(heartbeat_s, states, clock=clock)
    task = asyncio.create_task(announcer.run())
    try:
        yield announcer
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        await announcer.end()


@pytest.mark.seam
async def test_whoever_begins_to_receive_gets_a_sign_of_life_at_once() -> None:
    # No period would end while the test lasts.
    async with announcing(3600.0) as announcer:
        heard = Heard(await asyncio.to_thread(inlet, SOURCE))
        await eventually(heard.has(EventKind.HEARTBEAT))
        ((heartbeat, stamp),) = heard.events
        assert heartbeat["devices"] == STATES
        assert heartbeat["agent_started"] < stamp
        assert heartbeat["lsl_time"] == pytest.approx(stamp, abs=1e-6)
        pair = read_clock_pair(heartbeat)
        assert pair is not None
        # Of about this moment; what counts is that both are of the same.
        assert pair.lsl_s == pytest.approx(stamp, abs=1.0)
        here = measure_clock_pair(time.time_ns, pylsl.local_clock)
        assert pair.unix_ns / 1e9 - pair.lsl_s == pytest.approx(
            here.unix_ns / 1e9 - here.lsl_s, abs=0.001
        )
        del heard
        again = announcer.counters[SOURCE].pushed
        await asyncio.sleep(2 * TICK_S)
        assert announcer.counters[SOURCE].pushed == again
        second = Heard(await asyncio.to_thread(inlet, SOURCE))
        await eventually(second.has(EventKind.HEARTBEAT))


@pytest.fixture
def pushed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[dict[str, Any], float]]:
    """Return the events with their stamps as they go into the outlet."""
    noted: list[tuple[dict[str, Any], float]] = []
    push = Outlet.push_text

    def note(outlet: Outlet, text: str, stamp: float) -> None:
        assert " " not in text
        noted.append((json.loads(text), stamp))
        push(outlet, text, stamp)

    monkeypatch.setattr(Outlet, "push_text", note)
    return noted


async def test_signs_of_life_go_on_in_the_period(
    virtual_clock: Clock, pushed: list[tuple[dict[str, Any], float]]
) -> None:
    began = virtual_clock()
    async with announcing(5.0, clock=virtual_clock):
        await asyncio.sleep(61.0)
    start, *heartbeats = pushed
    assert start[0]["event"] == "agent_started"
    assert {event["event"] for event, _ in heartbeats} == {"heartbeat"}
    assert {event["agent_started"] for event, _ in heartbeats} == {round(began, 6)}
    # One at once; a look that is due may come with the next tick.
    assert heartbeats[0][1] == pytest.approx(began, abs=1e-4)
    periods = [later - earlier for (_, earlier), (_, later) in pairwise(heartbeats)]
    assert len(periods) in (11, 12)
    assert all(5.0 - 1e-4 < each < 5.0 + TICK_S + 1e-4 for each in periods)


async def test_a_sign_of_life_tells_what_is_wrong_if_anything_is(
    virtual_clock: Clock, pushed: list[tuple[dict[str, Any], float]]
) -> None:
    wrong: dict[str, object] = {}
    announcer = Announcer(5.0, lambda: STATES, lambda: wrong, clock=virtual_clock)
    wrong["zephyr/1"] = [{"what": "refused"}]
    task = asyncio.create_task(announcer.run())
    await asyncio.sleep(6.0)
    task.cancel()
    await announcer.end()
    _, first, second = (event for event, _ in pushed)
    assert "problems" not in first
    assert second["problems"] == wrong


@pytest.mark.nightly
async def test_heartbeats_can_be_switched_off(virtual_clock: Clock) -> None:
    async with announcing(0.0, clock=virtual_clock) as announcer:
        await asyncio.sleep(600.0)
        # The start, which nobody can have heard.
        assert announcer.counters[SOURCE].pushed == 1
        heard = Heard(await asyncio.to_thread(inlet, SOURCE))

        def is_received() -> bool:
            announcer.announce(EventKind.PAUSED, {})
            return "paused" in heard.kinds()

        await eventually(is_received)
        await asyncio.sleep(600.0)
        announcer.announce(EventKind.AGENT_STOPPED, {})
        await eventually(heard.has(EventKind.AGENT_STOPPED))
        assert set(heard.kinds()) == {"paused", "agent_stopped"}


@pytest.mark.nightly
async def test_the_last_word_is_heard_though_the_outlet_goes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # LSL's threads may be held up for longer than a person waits for the end.
    monkeypatch.setattr("biosensor_gateway.streaming.events.announcer.LINGER_S", 1.5)
    for _ in range(3):
        async with announcing(3600.0) as announcer:
            heard = Heard(await asyncio.to_thread(inlet, SOURCE))
            await eventually(heard.has(EventKind.HEARTBEAT))
            listening = asyncio.ensure_future(eventually(heard.has(EventKind.AGENT_STOPPED)))
            announcer.announce(EventKind.AGENT_STOPPED, {})
        # LSL gives nothing any more once it knows that the outlet has gone.
        with suppress(LostError):
            await listening
        assert heard.events[-1][0]["event"] == "agent_stopped"


@pytest.mark.nightly
async def test_stamps_never_run_back_and_the_text_says_when_it_was() -> None:
    async with announcing(3600.0) as announcer:
        heard = Heard(await asyncio.to_thread(inlet, SOURCE))
        await eventually(heard.has(EventKind.HEARTBEAT))
        now = pylsl.local_clock()
        announcer.announce(EventKind.PAUSED, {"sensor": "zephyr"}, now)
        announcer.announce(EventKind.GAP_START, {"sensor": "zephyr"}, now - 7.0)
        announcer.announce(EventKind.GAP_END, {"sensor": "zephyr"}, now + 0.5)
        await eventually(heard.has(EventKind.GAP_END))
    stamps = [stamp for _, stamp in heard.events]
    assert stamps == sorted(set(stamps))
    texts = [event["lsl_time"] for event, _ in heard.events[-3:]]
    assert texts == pytest.approx([now, now - 7.0, now + 0.5], abs=1e-6)
    assert stamps[-2] == pytest.approx(now, abs=1e-4)
    assert stamps[-1] == now + 0.5


async def test_an_agent_that_starts_says_its_version(
    pushed: list[tuple[dict[str, Any], float]],
) -> None:
    async with announcing(0.0):
        ((content, _),) = pushed
    assert (content["event"], content["version"]) == (
        "agent_started",
        version("biosensor-gateway"),
    )


@pytest.mark.nightly
async def test_nothing_that_fails_in_it_reaches_the_data(
    unit: str,
    virtual_clock: Clock,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def broken(*_arguments: object) -> NoReturn:
        raise OSError("the outlet is gone")

    sink = DeviceSink(DeviceIdentity("zephyr", unit), declaration("zephyr"), virtual_clock)
    with capture_logs() as logs:
        async with announcing(0.1, broken, virtual_clock) as announcer:
            events = sink.follow(announcer)
            monkeypatch.setattr(Outlet, "push_text", broken)
            sink.open(DeviceInfo(), {})
            reader = await asyncio.to_thread(inlet, f"zephyr-{unit}-ecg")
            for index in range(20):
                now = virtual_clock()
                sink.observe(8e8 + (index % 2) * 3600, now)
                sink.emit_at("ecg", [float(index)], [now])
                sink.emit_at("quality", [[float(index % 2)] * 6], [now])
                sink.lost("ecg", 1)
                events.dropped("lost")
            sink.pause()
            sink.resume()
            values: list[float] = []
            await eventually(
                lambda: bool(
                    values.extend(row[0] for row in reader.pull_chunk(timeout=0.0)[0])
                    or len(values) == 20
                )
            )
            await asyncio.sleep(10.0)
            sink.close()
    assert values == [float(index) for index in range(20)]
    assert {entry["of"] for entry in logs if "not announced" in entry["event"]} <= {
        "announce",
        "_tick",
    }


def test_a_failure_is_logged_once() -> None:
    @log_errors
    def fail(text: str) -> None:
        raise ValueError(text)

    with capture_logs() as logs:
        fail("first")
        fail("second")
    (entry,) = logs
    assert (entry["of"], entry["error"]) == ("fail", "first")


async def test_devices_are_streamed_also_if_there_can_be_no_such_stream(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_arguments: object) -> None:
        raise RuntimeError("no port is free")

    monkeypatch.setattr(outlets, "Outlet", refuse)
    with capture_logs() as logs:
        async with announcing(0.1) as announcer:
            announcer.announce(EventKind.PAUSED, {})
            assert announcer.counters == {}
    assert [entry["event"] for entry in logs] == ["there is no stream of events"]


def settings(path: Path, text: str) -> float:
    path.write_text(text)
    return load_settings(path, {}).events.heartbeat_s


def test_the_period_is_a_setting(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    assert settings(path, "") == 5.0
    assert settings(path, "[events]\nheartbeat_s = 0") == 0.0
    assert settings(path, "[events]\nheartbeat_s = 10") == 10.0
    assert settings(path, "[events]\nheartbeat_s = 2.5") == 2.5


@pytest.mark.parametrize("value", ["-1", "3601", "nan", "inf", '"5"', "true"])
def test_a_period_that_is_none_is_refused(tmp_path: Path, value: str) -> None:
    with pytest.raises(ConfigError, match=r"line 2: 'events\.heartbeat_s'"):
        settings(tmp_path / "settings.toml", f"[events]\nheartbeat_s = {value}")
