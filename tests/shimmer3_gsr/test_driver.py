"""The driver against a virtual Shimmer3 on a real serial port, and how it is found."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncGenerator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from structlog.testing import capture_logs

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.driver import Found
from biosensor_gateway.devices.shimmer.driver import connection as module
from biosensor_gateway.devices.shimmer.driver import conversation
from biosensor_gateway.devices.shimmer3_gsr.driver import DRIVER, ShimmerSettings, recognise
from biosensor_gateway.devices.shimmer3_gsr.simulator import SimulatedShimmer3
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.world import World
from biosensor_gateway.transports.nearby import Advertisement, SerialPort
from tests.rigs.driver_run import Run, supervised
from tests.rigs.polling import until

# The driver against a virtual Shimmer3 on a real serial port, under its supervisor.

DEADLINE_S = 30.0
WAVEFORMS = ("gsr", "ppg")
NEVER = float("inf")
Floats = NDArray[np.float64]


async def is_idle(device: SimulatedShimmer3) -> bool:
    """Tell whether the device has stopped measuring, by and by."""
    await asyncio.sleep(0.2)
    before = len(device.truth.samples("ppg").times)
    await asyncio.sleep(0.2)
    return len(device.truth.samples("ppg").times) == before


class ShimmerRun(Run):
    """The supervisor of a virtual device, that device, and what came of both."""

    def __init__(self, device: SimulatedShimmer3, **fields: Any) -> None:
        super().__init__(device, **fields)
        self.device = device

    async def more(self, samples: int = 60) -> None:
        wanted = len(self.sink.rows["gsr"]) + samples
        await until(self.sink.has(wanted, *WAVEFORMS))

    def measured(self) -> Floats:
        """Return what the device sent: gsr and ppg of each sample."""
        truth = [self.device.truth.samples(name).values[:, 0] for name in WAVEFORMS]
        return rows_of(*truth)

    def received(self) -> Floats:
        return rows_of(*(self.sink.array(name)[:, 0] for name in WAVEFORMS))

    async def both(self) -> tuple[Floats, Floats]:
        """Return what has arrived so far, and what the device sent, at least as much."""
        received = self.received()
        # The device notes a sample after it has left.
        await until(lambda: len(self.measured()) >= len(received))
        return received, self.measured()

    async def assert_nothing_invented(self) -> None:
        """Every sample that arrived was measured; once, in this order."""
        received, measured = await self.both()
        sent = iter(measured.tolist())
        for row in received.tolist():
            assert any(np.allclose(row, each, rtol=1e-9, equal_nan=True) for each in sent)
        for name, stamps in self.sink.times.items():
            assert all(a < b for a, b in pairwise(stamps)), name


def rows_of(*columns: Floats) -> Floats:
    count = min(len(column) for column in columns)
    return np.stack([column[:count] for column in columns], axis=1)


@pytest.fixture(autouse=True)
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(supervisor_module, "BACKOFF_CAP_S", 0.2)
    monkeypatch.setattr(conversation, "LISTEN_S", 0.2)
    monkeypatch.setattr(conversation, "QUIET_S", 0.1)


Streaming = Callable[..., AbstractAsyncContextManager[ShimmerRun]]


@pytest.fixture
def streaming(world: World) -> Streaming:
    """Run until the block ends; then nothing may have been refused or be half closed."""

    @asynccontextmanager
    async def started(
        *, settings: dict[str, Any] | None = None, **device: Any
    ) -> AsyncGenerator[ShimmerRun]:
        with SimulatedShimmer3(world, **device) as shimmer:
            async with supervised(ShimmerRun(shimmer, **(settings or {}))) as run:
                yield run

    return started


FIRMWARES = [(0, 11, 0), (0, 13, 7), (0, 16, 11), (1, 1, 2)]


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
async def test_every_firmware_delivers_every_sample(
    streaming: Streaming, firmware: tuple[int, int, int]
) -> None:
    async with streaming(firmware=firmware, seed=1, first_tick=(1 << 24) - 40_000) as run:
        await until(lambda: run.supervisor.state is State.STREAMING)
        await run.more(300)
        received, measured = await run.both()
        assert run.states == [State.CONNECTING, State.STREAMING]
    np.testing.assert_allclose(received, measured[: len(received)], rtol=1e-9)
    assert run.lost == {}
    assert run.sink.dropped_bytes == 0
    assert run.sink.clock_state.reanchors == 0


async def test_a_board_without_gsr_is_said_in_the_status(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory = replace(SimulatedShimmer3.memory, card=(47, 3, 0))
    monkeypatch.setattr(SimulatedShimmer3, "memory", memory)
    with SimulatedShimmer3(world) as device:
        async with supervised(ShimmerRun(device)) as run:
            await until(lambda: run.error)
        assert run.error == (
            "the expansion board (47) is not a GSR+ board, so gsr and ppg have no meaning"
        )


async def test_it_stops_the_device_at_the_end(streaming: Streaming) -> None:
    async with streaming() as run:
        await run.more()
    assert await is_idle(run.device)


async def test_the_real_rate_is_announced(streaming: Streaming) -> None:
    async with streaming(settings={"rate_hz": 100.0}) as run:
        await run.more(100)
    assert run.sink.rates == dict.fromkeys(WAVEFORMS, 32768 / 328)
    # By the device's own clock: who holds a packet up has no part in that.
    apart_s = np.diff(run.sink.device_times["ppg"])
    np.testing.assert_allclose(1 / apart_s.mean(), 32768 / 328, rtol=1e-4)
    assert run.lost == {}


@pytest.mark.parametrize("gsr_range", [0, 1, 2, 3])
async def test_a_fixed_range_is_set(streaming: Streaming, gsr_range: int) -> None:
    async with streaming(settings={"gsr_range": gsr_range}) as run:
        await run.more()
        received, measured = await run.both()
    np.testing.assert_allclose(received, measured[: len(received)], rtol=1e-9)
    assert set(run.sink.array("quality")[:, 1]) == {gsr_range}


async def test_over_tcp_it_is_the_same(streaming: Streaming) -> None:
    async with streaming(tcp=True, seed=3) as run:
        await run.more(200)
        received, measured = await run.both()
        run.device.apply(Fault(FaultKind.DROP, 0.5))
        await until(lambda: run.supervisor.connections == 2)
        await run.more(100)
        await run.assert_nothing_invented()
    np.testing.assert_allclose(received, measured[: len(received)], rtol=1e-9)


async def test_a_device_that_falls_silent_is_asked_then_connected_again(
    streaming: Streaming, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PATIENCE_S", 1.0)
    monkeypatch.setattr(conversation, "REPLY_TIMEOUT_S", 1.0)
    async with streaming(seed=8) as run:
        await run.more()
        before = len(run.states)
        run.device.apply(Fault(FaultKind.STALL, NEVER))
        await until(lambda: State.DISCOVERING in run.states[before:])
        assert "gone silent" in (run.supervisor.last_error or "")
        run.device.clear(FaultKind.STALL)
        await until(lambda: run.supervisor.connections == 2)
        await run.more()
        await run.assert_nothing_invented()
        unsent = run.device.truth.unsent_count("gsr")
    # An estimate: when exactly the device was cut off, only it knows.
    assert run.lost == dict.fromkeys(WAVEFORMS, pytest.approx(unsent, abs=40))


async def test_answers_that_come_too_late_never_pass_for_others(
    streaming: Streaming, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(conversation, "REPLY_TIMEOUT_S", 0.3)
    async with streaming(seed=11) as run:
        await run.more()
        run.device.apply(Fault(FaultKind.LATE, 0.5))
        await until(lambda: "does not answer" in (run.supervisor.last_error or ""))
        run.device.clear(FaultKind.LATE)
        await until(lambda: run.supervisor.connections == 2)
        await run.more()
        await run.assert_nothing_invented()


async def test_the_battery_is_asked_for_while_streaming(
    streaming: Streaming, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert module.BATTERY_PERIOD_S == 60
    monkeypatch.setattr(module, "BATTERY_PERIOD_S", 0.2)
    async with streaming(seed=13) as run:
        await until(run.sink.has(3, "bat"))
        run.device.apply(Fault(FaultKind.LOW_BATTERY, 4.0))
        await until(lambda: run.sink.array("bat")[-1, 0] < 6)
        truth = run.device.truth.samples("bat").values
        received = run.sink.array("bat")
    np.testing.assert_allclose(received, truth[: len(received)])
    assert run.lost == {}


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
async def test_docking_is_told_and_disturbs_nothing(
    streaming: Streaming, firmware: tuple[int, int, int]
) -> None:
    with capture_logs() as logs:
        async with streaming(firmware=firmware, seed=14) as run:
            for docked in (True, False) * 3:
                await run.more(15)
                run.device.dock(docked=docked)
            await run.more(30)
            received, measured = await run.both()
    told = [entry["event"] for entry in logs if "docked" in entry["event"]]
    assert told == ["not docked", *["docked", "not docked"] * 3]
    np.testing.assert_allclose(received, measured[: len(received)], rtol=1e-9)
    assert run.lost == {}


@pytest.mark.seam
async def test_a_device_that_was_left_streaming_is_stopped_first(world: World) -> None:
    with SimulatedShimmer3(world, firmware=(1, 1, 2), seed=16) as device:
        other = os.open(device.port, os.O_RDWR | os.O_NOCTTY)
        try:
            # Another layout, and checksums of another kind.
            for command in ("08842100", "05 20 00", "8b01", "07"):
                os.write(other, bytes.fromhex(command))
                await asyncio.sleep(0.2)
            await until(lambda: len(device.truth.samples("gsr").times) > 200)
            run = ShimmerRun(device)
            task = asyncio.create_task(run.supervisor.run())
            await run.more(100)
            received, measured = await run.both()
            task.cancel()
            await asyncio.wait({task}, timeout=DEADLINE_S)
            run.sink.close()
        finally:
            os.close(other)
    own = measured[-len(received) - 20 :]
    starts = [k for k in range(len(own) - 49) if np.allclose(own[k : k + 50], received[:50])]
    assert len(starts) == 1
    assert run.lost == {}


async def test_firmware_with_short_stamps_is_refused_with_an_advice(world: World) -> None:
    with SimulatedShimmer3(world, firmware=(0, 5, 2)) as device:
        run = ShimmerRun(device)
        driver = DRIVER.make(
            ShimmerSettings(sensor="shimmer3_gsr", unit="1", port=device.port), run.sink
        )()
        with pytest.raises(ProtocolError, match="too old; install LogAndStream") as caught:
            await driver.connect()
        await driver.close()
    assert caught.value.reason is ProtocolReason.UNSUPPORTED


async def test_a_stop_while_connecting_leaves_the_device_idle(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(conversation, "LISTEN_S", 0.01)
    for delay_s in (0.0, 0.1, 0.2, 0.3):
        with SimulatedShimmer3(world) as device:
            run = ShimmerRun(device)
            task = asyncio.create_task(run.supervisor.run())
            await asyncio.sleep(delay_s)
            task.cancel()
            await asyncio.wait({task}, timeout=DEADLINE_S)
            run.sink.close()
            assert await is_idle(device)


# Which serial ports are Shimmers.
@pytest.mark.parametrize("name", ["Shimmer3-9A3F", "Shimmer3-9a3f"])
def test_a_paired_shimmer_is_known_by_its_name(name: str) -> None:
    found = recognise(SerialPort("COM7", name, "00:06:66:46:9A:3F"))
    assert found == Found("shimmer3_gsr", name, {"unit": "9A3F", "port": "COM7"})
    settings = ShimmerSettings(sensor=found.sensor, **found.settings)  # type: ignore[arg-type]  # a mapping of scalars, as the file has it
    assert (settings.rate_hz, settings.gsr_range) == (128.0, "auto")


@pytest.mark.parametrize(
    "seen",
    [
        SerialPort("COM7"),
        SerialPort("COM7", "BH ZBH001234", "00:07:80:00:00:01"),
        SerialPort("COM7", "Shimmer3-9A3F2", "00:06:66:46:9A:3F"),
        Advertisement("00:06:66:46:9A:3F", "Shimmer3-9A3F"),
    ],
)
def test_others_are_not(seen: SerialPort | Advertisement) -> None:
    assert recognise(seen) is None


def test_the_driver_offers_it() -> None:
    assert DRIVER.recognise is recognise
    assert DRIVER.settings is ShimmerSettings
