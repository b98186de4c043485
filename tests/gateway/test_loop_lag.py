"""How late an event loop is, and that nobody takes it for a device's clock that was set."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator

import pytest

from biosensor_gateway.agent.device_set import KEPT_S, MOST_S, TICK_S, TURNS, LoopLag

HELD_S = 0.3


def hold_up(seconds: float) -> None:
    time.sleep(seconds)


@pytest.fixture
async def lag() -> AsyncGenerator[LoopLag]:
    lag = LoopLag()
    running = asyncio.create_task(lag.run())
    await asyncio.sleep(2 * TICK_S)
    yield lag
    running.cancel()


@pytest.mark.nightly
async def test_a_loop_that_is_held_up_is_late(lag: LoopLag) -> None:
    hold_up(HELD_S)
    # What comes meanwhile is taken in before the lag is measured again.
    assert HELD_S - TICK_S <= lag.seconds() <= MOST_S
    await asyncio.sleep(2 * TICK_S)
    assert HELD_S - TICK_S <= lag.seconds() <= MOST_S


@pytest.mark.nightly
async def test_it_is_forgotten_that_it_was_late(lag: LoopLag) -> None:
    hold_up(HELD_S)
    deadline = time.monotonic() + 30.0
    while lag.seconds() >= HELD_S - TICK_S:
        assert time.monotonic() < deadline
        await asyncio.sleep(TICK_S)
    assert time.monotonic() >= deadline - 30.0 + KEPT_S


@pytest.mark.nightly
async def test_a_stall_counts_as_far_as_a_busy_computer_would(lag: LoopLag) -> None:
    hold_up(2 * MOST_S)
    assert lag.seconds() == MOST_S
    assert lag.packet_delay_s() == TURNS * MOST_S
