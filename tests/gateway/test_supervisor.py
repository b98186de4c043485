"""The state machine around a driver: every transition, every way to stop."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterator
from typing import Any

import pytest
from structlog.testing import capture_logs

from biosensor_common.errors import (
    CredentialError,
    CredentialReason,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent import supervisor as module
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.driver import Connected
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.clock import Clock
from tests.rigs.polling import eventually

DISCOVERING, CONNECTING, STREAMING = State.DISCOVERING, State.CONNECTING, State.STREAMING
BACKOFF, STOPPED = State.BACKOFF, State.STOPPED
LONG_S = 3600.0

Step = Callable[[], Coroutine[Any, Any, None]]


async def at_once() -> None:
    pass


async def forever() -> None:
    await asyncio.Event().wait()


def failing(error: BaseException) -> Step:
    async def fail() -> None:
        raise error

    return fail


def lost() -> TransportError:
    return TransportError(TransportReason.LOST, "the link was cut")


def refused() -> ProtocolError:
    return ProtocolError(ProtocolReason.REFUSED, "the device refuses")


class ScriptedDriver:
    """Does what a test says; by default it connects and streams until it is stopped."""

    def __init__(
        self,
        connect: Step = at_once,
        stream: Step = forever,
        close: Step = at_once,
        silence_limit_s: float = LONG_S,
    ) -> None:
        self._connect, self._stream, self._close = connect, stream, close
        self.silence_limit_s = silence_limit_s
        self.closed = 0

    async def connect(self) -> Connected:
        await self._connect()
        return Connected()

    async def stream(self) -> None:
        await self._stream()

    async def close(self) -> None:
        self.closed += 1
        await self._close()


class Rig:
    """A supervisor, the drivers that it is given one after the other, what it did."""

    def __init__(self, unit: str, clock: Clock, drivers: Iterator[ScriptedDriver]) -> None:
        self.made: list[ScriptedDriver] = []
        self.states: list[State] = []
        self.sink = DeviceSink(DeviceIdentity("gateway", unit), declaration("gateway"), clock)
        self._drivers = drivers
        self.supervisor = Supervisor(self._make, self.sink, self.states.append)
        self.task = asyncio.create_task(self.supervisor.run())

    def _make(self) -> ScriptedDriver:
        self.made.append(next(self._drivers, ScriptedDriver()))
        return self.made[-1]

    async def stop(self) -> None:
        self.task.cancel()
        await asyncio.wait({self.task}, timeout=20)
        assert self.task.done()
        assert all(driver.closed == 1 for driver in self.made)
        self.sink.close()


Start = Callable[..., Rig]


@pytest.fixture
async def start(unit: str, virtual_clock: Clock) -> AsyncGenerator[Start]:
    rigs: list[Rig] = []

    def begin(*drivers: ScriptedDriver) -> Rig:
        rigs.append(Rig(f"{unit}{len(rigs)}", virtual_clock, iter(drivers)))
        return rigs[-1]

    yield begin
    for rig in rigs:
        await rig.stop()


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PROBE_INTERVAL_S", "BACKOFF_FIRST_S", "BACKOFF_CAP_S"):
        monkeypatch.setattr(module, name, 0.01)


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """What the supervisor would have waited, in place of waiting, without the jitter."""
    noted: list[float] = []

    def longest(_low: float, high: float) -> float:
        return high

    async def note(seconds: float) -> None:
        noted.append(seconds)
        await asyncio.sleep(0)

    monkeypatch.setattr(module, "sleep", note)
    monkeypatch.setattr(module.random, "uniform", longest)
    return noted


async def test_a_device_that_is_there_streams(start: Start) -> None:
    rig = start()
    await eventually(lambda: rig.supervisor.state is STREAMING)
    assert rig.states == [CONNECTING, STREAMING]
    assert rig.supervisor.connections == 1


@pytest.mark.usefixtures("hasty")
@pytest.mark.parametrize(
    "error",
    [
        TransportError(TransportReason.ABSENT, "nobody there"),
        TransportError(TransportReason.LOST, "nobody there"),
        TransportError(TransportReason.SILENT, "nobody there"),
        asyncio.CancelledError(),
    ],
    ids=["absent", "lost", "silent", "cancels itself"],
)
async def test_what_is_absent_is_probed(start: Start, error: BaseException) -> None:
    rig = start(ScriptedDriver(connect=failing(error)))
    await eventually(lambda: rig.supervisor.state is STREAMING)
    assert rig.states == [CONNECTING, DISCOVERING, CONNECTING, STREAMING]
    assert rig.supervisor.connections == 1


@pytest.mark.usefixtures("hasty")
@pytest.mark.parametrize(
    "error",
    [
        TransportError(TransportReason.BUSY, "another program holds it"),
        TransportError(TransportReason.DENIED, "no permission"),
        TransportError(TransportReason.UNAVAILABLE, "no radio"),
        refused(),
        ProtocolError(ProtocolReason.NO_REPLY, "no answer"),
        CredentialError(CredentialReason.REJECTED, "wrong secret"),
        RuntimeError("a mistake in the driver"),
        ExceptionGroup("two at once", [lost(), refused()]),
    ],
    ids=lambda error: f"{type(error).__name__}-{error}",
)
async def test_what_refuses_is_left_alone_for_a_while(start: Start, error: Exception) -> None:
    rig = start(ScriptedDriver(connect=failing(error)))
    await eventually(lambda: rig.supervisor.state is STREAMING)
    assert rig.states == [CONNECTING, BACKOFF, CONNECTING, STREAMING]


@pytest.mark.usefixtures("hasty")
@pytest.mark.parametrize(
    ("error", "then"),
    [
        (lost(), DISCOVERING),
        (refused(), BACKOFF),
        (ValueError("a mistake in the driver"), BACKOFF),
        (ExceptionGroup("tasks", [lost()]), DISCOVERING),
        (ExceptionGroup("tasks", [ExceptionGroup("more tasks", [refused()])]), BACKOFF),
        (asyncio.CancelledError(), DISCOVERING),
    ],
    ids=lambda value: str(value) or "cancelled",
)
async def test_a_connection_that_ends_is_made_again(
    start: Start, error: BaseException, then: State
) -> None:
    rig = start(ScriptedDriver(stream=failing(error)))
    await eventually(lambda: rig.supervisor.connections == 2)
    assert rig.states == [CONNECTING, STREAMING, then, CONNECTING, STREAMING]
    assert rig.made[0].closed == 1


@pytest.mark.usefixtures("hasty")
async def test_since_when_it_does_not_stream_is_kept_over_its_attempts(start: Start) -> None:
    rig = start(ScriptedDriver(connect=failing(lost())))
    away_since = rig.supervisor.away_since
    assert away_since is not None
    await eventually(lambda: DISCOVERING in rig.states)
    assert rig.supervisor.away_since == away_since
    await eventually(lambda: rig.supervisor.state is STREAMING)
    assert rig.supervisor.away_since is None


@pytest.mark.usefixtures("hasty")
async def test_a_driver_that_just_stops_is_started_again(start: Start) -> None:
    rig = start(ScriptedDriver(stream=at_once))
    await eventually(lambda: rig.supervisor.connections == 2)
    assert rig.states[:3] == [CONNECTING, STREAMING, DISCOVERING]


@pytest.mark.usefixtures("hasty")
async def test_silence_ends_a_connection(start: Start) -> None:
    with capture_logs() as logs:
        rig = start(ScriptedDriver(silence_limit_s=0.05))
        await eventually(lambda: rig.supervisor.connections == 2)
    assert rig.states == [CONNECTING, STREAMING, DISCOVERING, CONNECTING, STREAMING]
    assert [entry["reason"] for entry in logs if "reason" in entry] == ["silent"]


async def test_a_device_that_is_heard_is_not_silent(start: Start) -> None:
    rig: Rig | None = None
    count = 0

    async def chatter() -> None:
        nonlocal count
        while True:
            assert rig is not None
            rig.sink.heard()
            count += 1
            await asyncio.sleep(0.01)

    rig = start(ScriptedDriver(stream=chatter, silence_limit_s=1.0))
    # Two silence limits and more.
    await eventually(lambda: count > 250)
    assert rig.states == [CONNECTING, STREAMING]


async def test_the_back_off_doubles_up_to_its_cap(start: Start, waits: list[float]) -> None:
    rig = start(*(ScriptedDriver(connect=failing(refused())) for _ in range(8)))
    await eventually(lambda: rig.supervisor.state is STREAMING)
    assert waits == [1, 2, 4, 8, 16, 30, 30, 30]


async def test_a_device_may_refuse_for_days(start: Start, waits: list[float]) -> None:
    rig = start(*(ScriptedDriver(connect=failing(refused())) for _ in range(1200)))
    await eventually(lambda: rig.supervisor.state is STREAMING)
    assert set(waits[10:]) == {module.BACKOFF_CAP_S}


async def test_probing_keeps_its_pace(start: Start, waits: list[float]) -> None:
    rig = start(*(ScriptedDriver(connect=failing(lost())) for _ in range(5)))
    await eventually(lambda: rig.supervisor.state is STREAMING)
    assert waits == [module.PROBE_INTERVAL_S] * 5
    assert module.PROBE_INTERVAL_S <= 2


@pytest.mark.parametrize(("stable_after_s", "last"), [(0.0, 1), (LONG_S, 8)])
async def test_only_a_stable_connection_clears_the_back_off(
    start: Start,
    waits: list[float],
    monkeypatch: pytest.MonkeyPatch,
    stable_after_s: float,
    last: float,
) -> None:
    monkeypatch.setattr(module, "STABLE_AFTER_S", stable_after_s)
    failures = [ScriptedDriver(connect=failing(refused())) for _ in range(3)]
    rig = start(*failures, ScriptedDriver(stream=failing(refused())))
    await eventually(lambda: rig.supervisor.connections == 2)
    assert waits == [1, 2, 4, last]


@pytest.mark.parametrize("jitter", [0.75, 1.0])
async def test_the_jitter_stays_within_a_quarter(
    start: Start, monkeypatch: pytest.MonkeyPatch, jitter: float
) -> None:
    def note(low: float, high: float) -> float:
        assert (low, high) == (0.75, 1.0)
        return jitter * 0.001

    monkeypatch.setattr(module.random, "uniform", note)
    rig = start(ScriptedDriver(connect=failing(refused())))
    await eventually(lambda: rig.supervisor.state is STREAMING)


@pytest.mark.usefixtures("hasty")
async def test_an_unknown_exception_is_logged_with_its_traceback(start: Start) -> None:
    mistake = ZeroDivisionError("in the driver")
    with capture_logs() as logs:
        rig = start(ScriptedDriver(stream=failing(mistake)))
        await eventually(lambda: rig.supervisor.connections == 2)
    errors = [entry for entry in logs if entry["log_level"] == "error"]
    assert [entry["exc_info"] for entry in errors] == [mistake]
    assert errors[0]["unit"] == rig.sink.identity.unit


@pytest.mark.usefixtures("hasty")
async def test_the_same_sentence_is_logged_once(start: Start) -> None:
    absent = TransportError(TransportReason.ABSENT, "there is no such port")
    with capture_logs() as logs:
        rig = start(*(ScriptedDriver(connect=failing(absent)) for _ in range(5)))
        await eventually(lambda: len(rig.made) == 5)
        assert rig.supervisor.last_error == "there is no such port"
        await eventually(lambda: rig.supervisor.state is STREAMING)
    assert [entry["event"] for entry in logs].count("there is no such port") == 1
    assert rig.supervisor.last_error is None


@pytest.mark.usefixtures("hasty")
async def test_a_driver_that_cannot_be_made_is_retried(unit: str, virtual_clock: Clock) -> None:
    attempts = 0

    def make() -> ScriptedDriver:
        nonlocal attempts
        attempts += 1
        if attempts < 3:
            raise ImportError("a library is missing")
        return ScriptedDriver()

    sink = DeviceSink(DeviceIdentity("gateway", unit), declaration("gateway"), virtual_clock)
    supervisor = Supervisor(make, sink)
    task = asyncio.create_task(supervisor.run())
    await eventually(lambda: supervisor.state is STREAMING)
    task.cancel()
    await asyncio.wait({task})
    assert attempts == 3
    sink.close()


@pytest.mark.parametrize("state", [CONNECTING, STREAMING, DISCOVERING, BACKOFF])
@pytest.mark.parametrize("close", [at_once, forever, failing(OSError("the port hangs"))])
async def test_every_state_can_be_stopped_whatever_closing_does(
    start: Start,
    monkeypatch: pytest.MonkeyPatch,
    state: State,
    close: Step,
) -> None:
    monkeypatch.setattr(module, "CLOSE_TIMEOUT_S", 0.05)
    connect = {
        CONNECTING: forever,
        STREAMING: at_once,
        DISCOVERING: failing(lost()),
        BACKOFF: failing(refused()),
    }[state]
    rig = start(ScriptedDriver(connect=connect, close=close))
    await eventually(lambda: state in rig.states)
    await rig.stop()
    assert rig.task.cancelled()
    assert rig.states[-2:] == [state, STOPPED]
    assert len(rig.made) == 1


async def test_a_stop_before_the_first_step_is_a_stop(start: Start) -> None:
    rig = start()
    await rig.stop()
    assert rig.task.cancelled()
    assert rig.made == []


async def test_a_driver_that_will_not_end_closing_is_left_behind(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "CLOSE_TIMEOUT_S", 0.05)
    released = asyncio.Event()

    async def stubborn() -> None:
        while not released.is_set():
            try:
                await released.wait()
            except asyncio.CancelledError:
                continue

    with capture_logs() as logs:
        rig = start(ScriptedDriver(close=stubborn))
        await eventually(lambda: rig.supervisor.state is STREAMING)
        await rig.stop()
        assert rig.states[-1] is STOPPED
    assert any("closing" in entry["event"] for entry in logs)
    released.set()
    await asyncio.sleep(0)


async def test_a_stop_while_closing_lets_the_closing_finish(start: Start) -> None:
    begun, proceed, finished = asyncio.Event(), asyncio.Event(), asyncio.Event()

    async def slow() -> None:
        begun.set()
        await proceed.wait()
        finished.set()

    rig = start(ScriptedDriver(stream=failing(lost()), close=slow))
    await eventually(begun.is_set)
    rig.task.cancel()
    await asyncio.sleep(0.01)
    proceed.set()
    await rig.stop()
    assert finished.is_set()
    assert rig.states[-1] is STOPPED


@pytest.mark.usefixtures("hasty")
async def test_one_failing_device_disturbs_no_other(start: Start) -> None:
    count = 0

    async def tick() -> None:
        nonlocal count
        while True:
            count += 1
            await asyncio.sleep(0.001)

    good = start(ScriptedDriver(stream=tick))
    faults = (lost(), refused(), KeyError("a mistake"), asyncio.CancelledError())
    bad = start(
        *(ScriptedDriver(connect=failing(fault)) for fault in faults),
        *(ScriptedDriver(stream=failing(fault)) for fault in faults),
    )
    await eventually(lambda: len(bad.made) == 9)
    before = count
    await eventually(lambda: count > before)
    assert good.states == [CONNECTING, STREAMING]
    assert len(good.made) == 1
