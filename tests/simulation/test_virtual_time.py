"""The clock that tests go by: it jumps, it waits for whoever works, it repeats itself."""

from __future__ import annotations

import asyncio
import threading
import time
from concurrent.futures import Future

import pytest

from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World
from tests.rigs.driver_run import streaming
from tests.rigs.polling import until
from tests.rigs.virtual_time import VirtualTime, virtual_time

HOUR_S = 3600.0
STREAMING_S = 30.0


async def test_an_hour_of_nothing_takes_no_time(virtual_clock: VirtualTime) -> None:
    begun_s, begun_real_s = virtual_clock(), time.monotonic()
    await asyncio.sleep(HOUR_S)
    assert virtual_clock() - begun_s == pytest.approx(HOUR_S)
    assert time.monotonic() - begun_real_s < HOUR_S / 60


async def test_what_is_due_comes_in_order_whoever_waits_for_it(virtual_clock: VirtualTime) -> None:
    order: list[tuple[str, float]] = []
    begun_s = virtual_clock()

    async def tick(who: str, period_s: float) -> None:
        for _ in range(3):
            await asyncio.sleep(period_s)
            order.append((who, round(virtual_clock() - begun_s, 6)))

    with World(virtual_clock) as world:
        there = asyncio.wrap_future(
            asyncio.run_coroutine_threadsafe(tick("world", 2.0), world.loop)
        )
        await asyncio.gather(tick("test", 1.5), there)
    assert order == [
        ("test", 1.5), ("world", 2.0), ("test", 3.0), ("world", 4.0), ("test", 4.5), ("world", 6.0)
    ]  # fmt: skip


def _some_work() -> int:
    """Take a while, without waiting."""
    return sum(range(1_000_000))


async def test_time_stands_still_while_a_job_is_done(virtual_clock: VirtualTime) -> None:
    begun_s = virtual_clock()
    late = asyncio.create_task(asyncio.sleep(HOUR_S))
    await asyncio.to_thread(_some_work)
    assert virtual_clock() == pytest.approx(begun_s, abs=1e-6)
    assert not late.done()
    await late


async def test_time_goes_on_while_a_job_waits_for_it(virtual_clock: VirtualTime) -> None:
    begun_s = virtual_clock()
    with World(virtual_clock) as world:
        await asyncio.to_thread(lambda: world.await_(asyncio.sleep(HOUR_S)))
    assert virtual_clock() - begun_s == pytest.approx(HOUR_S)


async def test_a_thread_waits_for_a_result_of_somebody_who_takes_no_turns(
    virtual_clock: VirtualTime,
) -> None:
    result = Future[int]()
    threading.Thread(target=lambda: result.set_result(_some_work())).start()
    assert virtual_clock.wait_for(result, 20.0) == _some_work()


async def test_who_waits_for_what_never_comes_is_told(virtual_clock: VirtualTime) -> None:
    with pytest.raises(TimeoutError):
        virtual_clock.wait_for(Future[None](), 0.01)


@pytest.mark.nightly
async def test_afterwards_the_loop_goes_by_the_system_again() -> None:
    with virtual_time():
        await asyncio.sleep(HOUR_S)
    begun_s = time.monotonic()
    await asyncio.sleep(0.01)
    assert asyncio.get_running_loop().time() - begun_s < HOUR_S / 2


async def _half_a_minute() -> tuple[list[float], list[float]]:
    """Stream and return the values, and their times since the first."""
    with virtual_time() as clock, World(clock) as world:
        radio = Radio(world)
        wearer = Wearer(seed=3, heart_rate_bpm=100)
        with (
            virtual_bluetooth(radio),
            SimulatedPolarH10(world, radio, wearer=wearer, seed=4, jitter_s=0.02) as strap,
        ):
            async with streaming(strap) as run:
                await until(run.sink.has(1, "ecg"))
                await asyncio.sleep(STREAMING_S)
        times = run.sink.times["ecg"]
        return run.sink.values("ecg"), [each - times[0] for each in times]


async def test_half_a_minute_of_streaming_is_the_same_each_time() -> None:
    values, times = await _half_a_minute()
    again, times_again = await _half_a_minute()
    assert times[-1] > STREAMING_S - 2
    assert again == values
    assert times_again == pytest.approx(times, abs=1e-6)
