"""The stream of events: signs of life, stamps, and that it never harms the data."""

from __future__ import annotations

import asyncio
import json
import socket
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping
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
from biosensor_common.ros_clock import measure_clock_pair, read_clock_pair
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.settings.file import load_settings
from biosensor_gateway.streaming import outlets
from biosensor_gateway.streaming.events import EventKind
from biosensor_gateway.streaming.events.announcer import TICK_S, Announcer
from biosensor_gateway.streaming.outlets import Outlet, log_errors
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.clock import LSL_CLOCK, Clock

SOURCE = naming.source_id(DeviceIdentity("gateway", socket.gethostname()), "events")
STATES = {"zephyr/1": "streaming"}

OpenInlet = Callable[[str], pylsl.StreamInlet]
Eventually = Callable[[Callable[[], bool]], Awaitable[None]]


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
async def test_whoever_begins_to_receive_gets_a_sign_of_life_at_once(
    inlet: OpenInlet, eventually: Eventually
) -> None:
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
async def test_heartbeats_can_be_switched_off(
    inlet: OpenInlet, eventually: Eventually, virtual_clock: Clock
) -> None:
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
    inlet: OpenInlet, eventually: Eventually, monkeypatch: pytest.MonkeyPatch
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
async def test_stamps_never_run_back_and_the_text_says_when_it_was(
    inlet: OpenInlet, eventually: Eventually
) -> None:
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
    inlet: OpenInlet,
    eventually: Eventually,
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
