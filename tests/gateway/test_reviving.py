"""What is done about silent streams, and which device has room for its streams."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from structlog.testing import capture_logs

from biosensor_common.errors import ProtocolError, ProtocolReason, TransportError, TransportReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import supervisor
from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.agent.device_set import Device, DeviceSet
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.agent.status import DeviceStatus
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.driver import Connected
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.streaming import silence as silence_module
from biosensor_gateway.streaming.events.announcer import Announcer
from biosensor_gateway.streaming.room import Room
from biosensor_gateway.streaming.silence import Remedy, Silence
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.clock import Clock
from tests.rigs.polling import eventually

# What is done about silent streams, where it shows, and that it ends.

LIMIT_S = 0.2
LONG_S = 3600.0


class Sender:
    """A driver that sends what its test wants, many times a second."""

    silence_limit_s = LONG_S

    def __init__(self, bench: SupervisedDriver) -> None:
        self.bench = bench

    async def connect(self) -> Connected:
        # The waveforms are not due: this test would have to wait for them.
        due = {"hr": LIMIT_S, "ibi": LIMIT_S}
        denied = dict(self.bench.denied)
        refused = frozenset({"ecg", "acc"}) - denied.keys()
        return Connected(rates={"acc": 50.0}, refused=refused, due=due, denied=denied)

    async def stream(self) -> None:
        while True:
            for data_name in self.bench.sends:
                self.bench.sink.emit_at(data_name, [1.0], [self.bench.sink.clock()])
            self.bench.sink.heard()
            self.bench.sink.dropped_bytes += self.bench.unreadable
            await asyncio.sleep(LIMIT_S / 10)

    async def close(self) -> None:
        self.bench.sends |= self.bench.sends_after_new_connection


class SilenceRecovery(Sender):
    """One that can be asked again."""

    async def enable_again(self, streams: frozenset[str]) -> None:
        self.bench.asked.append(set(streams))
        if self.bench.refusal is not None:
            raise self.bench.refusal
        self.bench.sends |= streams & self.bench.can_be_enabled


class Silent(Sender):
    """One of which nothing is due, and nothing can be read."""

    silence_limit_s = LIMIT_S

    async def connect(self) -> Connected:
        return Connected(refused=frozenset({"ecg", "acc"}))

    async def stream(self) -> None:
        await asyncio.sleep(LIMIT_S / 2)
        self.bench.sink.dropped_bytes += 9
        await asyncio.sleep(LONG_S)


class NotedSilences(DeviceSink):
    """Notes what is told of silences besides telling it."""

    def __init__(self, unit: str, clock: Clock) -> None:
        super().__init__(DeviceIdentity("polar_h10", unit), declaration("polar_h10"), clock)
        self.told: list[tuple[Remedy, set[str]]] = []
        self.on_back: Callable[[], None] = lambda: None

    def tell_silent(self, silence: Silence) -> None:
        super().tell_silent(silence)
        self.told.append((silence.remedy, set(silence.streams)))

    def tell_came_back(self, streams: frozenset[str]) -> None:
        self.on_back()
        super().tell_came_back(streams)


class SupervisedDriver:
    """A supervised driver, and what it shall do."""

    def __init__(
        self, unit: str, clock: Clock, kind: type[Sender], denied: Mapping[str, str]
    ) -> None:
        self.sends = {"hr", "ibi"}
        self.can_be_enabled: set[str] = set()
        self.sends_after_new_connection: set[str] = set()
        self.refusal: ProtocolError | None = None
        self.unreadable = 0
        self.denied = denied
        self.asked: list[set[str]] = []
        self.states: list[State] = []
        self.sink = NotedSilences(unit, clock)
        self.announcer = Announcer(0.0, dict, clock=clock)
        self.supervisor = Supervisor(lambda: kind(self), self.sink, self.states.append)
        self.supervisor.on_drop = self.sink.follow(self.announcer).dropped
        self.task = asyncio.create_task(self.supervisor.run())

    @property
    def reason(self) -> str:
        return self.supervisor.last_error or ""

    def status(self) -> DeviceStatus:
        return Device(self.supervisor, self.sink).status()

    def problems(self) -> list[dict[str, object]]:
        """Return what heartbeats tell of it."""
        return Device(self.supervisor, self.sink).problems()

    async def end(self) -> None:
        self.task.cancel()
        await asyncio.wait({self.task}, timeout=20)
        self.sink.close()
        await self.announcer.end()


Start = Callable[..., Awaitable[SupervisedDriver]]


@pytest.fixture
async def start(
    unit: str, virtual_clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> AsyncGenerator[Start]:
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.01)
    monkeypatch.setattr(supervisor, "TICK_S", 0.01)
    monkeypatch.setattr(silence_module, "RETRY_S", LONG_S)
    benches: list[SupervisedDriver] = []

    async def begin(kind: type[Sender], **denied: str) -> SupervisedDriver:
        benches.append(SupervisedDriver(unit, virtual_clock, kind, denied))
        await eventually(lambda: benches[-1].supervisor.state is State.STREAMING)
        return benches[-1]

    yield begin
    for bench in benches:
        await bench.end()


@pytest.fixture
def announced(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[dict[str, Any]]]:
    """Return what comes into the stream of events about silences."""
    noted: list[dict[str, Any]] = []
    announce = Announcer.announce

    def note(self: Announcer, kind: Any, facts: Any, at: float | None = None) -> None:
        announce(self, kind, facts, at)
        if kind.value.startswith("streams_"):
            # What is no JSON would have been left out.
            noted.append({"event": kind.value, **json.loads(json.dumps(facts))})

    monkeypatch.setattr(Announcer, "announce", note)
    yield noted


async def test_what_falls_silent_is_enabled_again_and_said_until_it_comes(
    start: Start, announced: list[dict[str, Any]]
) -> None:
    bench = await start(SilenceRecovery)
    reasons: list[DeviceStatus] = []
    with capture_logs() as logs:
        bench.can_be_enabled = {"ibi"}
        bench.sends = {"hr"}
        bench.sink.on_back = lambda: reasons.append(bench.status())
        await eventually(lambda: bench.states[-2:] == [State.ENABLING, State.STREAMING])
    assert bench.asked == [{"ibi"}]
    assert bench.supervisor.connections == 1
    assert bench.status().error is None
    assert [(each.state, "no data of ibi" in (each.error or "")) for each in reasons[-1:]] == [
        ("enabling", True)
    ]
    said = [entry["event"] for entry in logs if "data" in entry["event"]]
    assert said == ["connected, but no data of ibi for 0 s; enabling again", "data come again"]
    assert [(each["event"], each["streams"]) for each in announced] == [
        ("streams_silent", ["ibi"]),
        ("streams_back", ["ibi"]),
    ]
    assert announced[0]["remedy"] == "enabling again"


async def test_what_cannot_be_enabled_costs_one_connection_and_leaves_a_reason(
    start: Start, announced: list[dict[str, Any]]
) -> None:
    bench = await start(SilenceRecovery)
    with capture_logs() as logs:
        bench.sends = {"hr"}
        await eventually(lambda: (Remedy.NONE, {"ibi"}) in bench.sink.told)
        await eventually(lambda: bench.supervisor.state is State.STREAMING)
    assert [remedy for remedy, _ in bench.sink.told] == [
        Remedy.ENABLE,
        Remedy.RECONNECT,
        Remedy.ENABLE,
        Remedy.NONE,
    ]
    assert bench.supervisor.connections == 2
    reason = bench.status().error or ""
    assert "no data of ibi" in reason
    assert "switch the device off and on" in reason
    assert any(entry["event"] == reason for entry in logs)
    assert [each["remedy"] for each in announced] == [
        "enabling again",
        "connecting again",
        "enabling again",
        "none",
    ]
    # It comes back by itself, and nothing is wrong any more.
    bench.sends = {"hr", "ibi"}
    await eventually(lambda: bench.status().error is None)
    assert announced[-1]["event"] == "streams_back"


async def test_a_driver_without_the_hook_is_connected_again(start: Start) -> None:
    bench = await start(Sender)
    bench.sends_after_new_connection = {"hr", "ibi"}
    bench.sends = set()
    await eventually(lambda: bench.supervisor.connections == 2)
    assert bench.sink.told == [(Remedy.RECONNECT, {"hr", "ibi"})]
    await eventually(lambda: bench.status().error is None)


async def test_the_reason_outlives_connections_that_bring_nothing(start: Start) -> None:
    bench = await start(SilenceRecovery)
    bench.sends = set()
    await eventually(lambda: bench.supervisor.connections == 3)
    for _ in range(20):
        assert "no data of hr, ibi" in bench.reason
        await asyncio.sleep(LIMIT_S / 20)


async def test_a_device_that_refuses_to_be_enabled_is_connected_again(start: Start) -> None:
    bench = await start(SilenceRecovery)
    bench.refusal = ProtocolError(ProtocolReason.NO_REPLY, "the device does not answer")
    bench.sends_after_new_connection = {"hr", "ibi"}
    bench.sends = set()
    with capture_logs() as logs:
        await eventually(lambda: bench.supervisor.connections == 2)
    assert State.BACKOFF not in bench.states
    assert any(
        entry["event"] == "the device does not answer" and entry["reason"] == "silent"
        for entry in logs
    )


async def test_what_the_device_refuses_is_said_until_it_comes(
    start: Start, announced: list[dict[str, Any]]
) -> None:
    with capture_logs() as logs:
        bench = await start(Sender, ecg="no room", acc="it is full", quality="no room")
        await eventually(lambda: bool(bench.reason))
        assert bench.reason == (
            "connected, but the device refuses acc (it is full); ecg, quality (no room)"
        )
        # Something else that falls silent comes first, until it is back.
        bench.sends_after_new_connection = {"hr", "ibi"}
        bench.sends = {"hr"}
        await eventually(lambda: bench.supervisor.connections == 2 and "refuses" in bench.reason)
        bench.sends |= {"ecg", "acc"}
        await eventually(lambda: "acc" not in bench.reason)
        assert bench.reason == "connected, but the device refuses quality (no room)"
        assert bench.problems() == [{"what": bench.reason}]
        bench.sink.pause()
        assert not bench.problems()
        bench.sink.resume()
        bench.sends |= {"quality"}
        await eventually(lambda: bench.status().error is None)
        assert not bench.problems()
        # What has passed has its time.
        bench.sink.left_out(2, "they came twice")
        (left_out,) = bench.problems()
        assert left_out["last"] == round(bench.sink.refusals.present[0].last_s, 6)
    assert bench.states[:3] == [State.CONNECTING, State.STREAMING, State.DISCOVERING]
    assert announced[0] == {
        "event": "streams_silent",
        "sensor": "polar_h10",
        "unit": bench.sink.identity.unit,
        "streams": ["acc"],
        "seconds": 0.0,
        "remedy": "none",
        "why": "it is full",
    }
    assert {each["log_level"] for each in logs if "refuses" in each["event"]} == {"warning"}


async def test_what_cannot_be_read_is_part_of_the_reason_if_it_came_since(start: Start) -> None:
    bench = await start(SilenceRecovery)
    # Of the hours before, with data among it.
    bench.sink.dropped_bytes += 5000
    for _ in range(40):
        await asyncio.sleep(LIMIT_S / 10)
    bench.sends = set()
    await asyncio.sleep(LIMIT_S / 2)
    bench.sink.dropped_bytes += 812
    await eventually(lambda: "(812 unreadable bytes came); enabling" in bench.reason)
    bench.unreadable = 7
    await eventually(lambda: "connecting again; look for an update of its soft" in bench.reason)
    # It has been enabled with everything else, and is not streaming because of that.
    await eventually(lambda: bench.supervisor.connections > 2)
    assert bench.states.count(State.STREAMING) == 1


async def test_a_device_that_is_silent_at_last_says_what_came_of_it(start: Start) -> None:
    bench = await start(Silent)
    await eventually(
        lambda: "nothing from the device for 0 s (9 unreadable bytes came" in bench.reason
    )


async def test_nobody_misses_what_a_pause_would_withhold(start: Start) -> None:
    bench = await start(SilenceRecovery)
    bench.sink.pause()
    bench.sends = set()
    for _ in range(30):
        await asyncio.sleep(LIMIT_S / 10)
    assert bench.sink.told == []
    bench.sink.resume()
    await eventually(lambda: bench.sink.told[:1] == [(Remedy.ENABLE, {"hr", "ibi"})])


# Devices have room for their streams in the order of the settings, as far as there is some.
ENDS_WITHIN_S = 60.0


def test_devices_get_room_in_the_order_of_the_settings() -> None:
    room = Room(20)
    said = room.share_out({"polar_h10/a": 7, "zephyr/b": 14, "muse/c": 8})
    assert said.startswith(
        "there is room for 20 streams, and 29 are requested; left out are zephyr/b (14): this"
    )
    assert [room.has(each) for each in ("polar_h10/a", "zephyr/b", "muse/c")] == [True, False, True]
    with pytest.raises(
        TransportError, match=r"its 14 streams are left out.* run in this"
    ) as caught:
        room.take("zephyr/b", 14)
    assert caught.value.reason is TransportReason.EXHAUSTED


def test_room_that_is_given_back_is_another_devices() -> None:
    room = Room(10)
    room.share_out({"polar_h10/a": 7, "muse/c": 8})
    room.give_back("polar_h10/a")
    room.take("muse/c", 8)
    # A device that has room already needs no more.
    room.take("muse/c", 8)
    with pytest.raises(TransportError):
        room.take("polar_h10/a", 7)


def test_nothing_is_said_where_all_fit() -> None:
    assert Room(15).share_out({"polar_h10/a": 7, "muse/c": 8}) == ""
    assert Room(None).share_out({"polar_h10/a": 10_000}) == ""


def test_an_agent_without_room_for_any_device_ends() -> None:
    device = DeviceSettings(sensor="gateway", unit="a")
    identity = DeviceIdentity("gateway", "a")
    sink = DeviceSink(identity, declaration("gateway"))
    made = Device(Supervisor(lambda: pytest.fail("it is connected"), sink), sink)
    devices = dict(zip([device], [made], strict=True))
    with pytest.raises(
        TransportError, match=r"^there is room for 0 streams, .* left out are gateway/a"
    ) as caught:
        DeviceSet(devices, Room(0)).make_room()
    assert caught.value.reason is TransportReason.EXHAUSTED
    fleet = DeviceSet(devices, Room(made.streams))
    fleet.make_room()
    assert fleet.with_room == [made]


AGENT = """
import resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (100, int(sys.argv.pop(1))))
from biosensor_gateway.cli import main
main()
"""


def start_with_room(folder: Path, limit: int, devices: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", AGENT, str(limit), "run", "--simulate", devices],
        env={**os.environ, "BIOSENSOR_GATEWAY_STATE": str(folder)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def states(folder: Path) -> dict[str, tuple[str, str]]:
    try:
        devices = json.loads((folder / "status.json").read_text())["devices"]
    except (OSError, ValueError):
        return {}
    return {each["sensor"]: (each["state"], each["error"] or "") for each in devices}


@pytest.mark.seam
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such limit")
def test_an_agent_streams_what_fits_and_says_what_is_left_out(tmp_path: Path) -> None:
    agent = start_with_room(tmp_path, 450, "polar_h10,zephyr")
    try:
        until_s = time.monotonic() + ENDS_WITHIN_S
        while states(tmp_path).get("polar_h10", ("", ""))[0] != "streaming":
            assert agent.poll() is None
            assert time.monotonic() < until_s, states(tmp_path)
            time.sleep(0.1)
        state, error = states(tmp_path)["zephyr"]
    finally:
        agent.terminate()
        _, said = agent.communicate(timeout=ENDS_WITHIN_S)
    assert state == "backoff"
    assert error.startswith("its 13 streams are left out: this computer lets a program open 450")
    assert "left out are zephyr/virtual (13)" in said
    assert agent.returncode == 0
