"""The driver under its supervisor, and samples that the radio or a pause costs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractAsyncContextManager
from typing import Any

import numpy as np
import pytest
from structlog.testing import capture_logs

from biosensor_gateway.devices.empatica_e4.driver import emitter as emitter_module
from biosensor_gateway.devices.empatica_e4.simulator import Timing
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.world import World
from tests.empatica_e4.steering import SteeredE4

REGULAR = ("bvp", "acc", "gsr", "st")
# Without a rival for the processor it is a hundredth of that.
NEAR_S = 0.15

Running = Callable[[Mapping[str, Any]], AbstractAsyncContextManager[Any]]


@pytest.fixture
def short_window(monkeypatch: pytest.MonkeyPatch) -> float:
    """Estimate losses every two seconds."""
    monkeypatch.setattr(emitter_module, "WINDOW_S", 2.0)
    return 2.0


async def test_radio_loss_is_estimated_and_moves_the_stamps_back_to_their_place(
    world: World, running: Running, short_window: float
) -> None:
    with SteeredE4(world, timing=Timing(burst=1)) as server, capture_logs() as logs:
        async with running(server.settings) as run:
            await run.until_more(rows=128)
            server.lose_packets(1.0, 0.4)
            lost: Callable[[], int] = lambda: run.sink.counted("bvp").lost  # noqa: E731
            await run.until(lost)
            # If the packet on which the stamps hang from now on is late, that is taken off.
            await run.until_more(rows=192)
            true = {name: server.truth.unsent_count(name) for name in REGULAR}
            assert true["bvp"] > 20
            assert run.sink.counted("bvp").lost == pytest.approx(true["bvp"], abs=4)
            assert run.sink.counted("acc").lost == pytest.approx(true["acc"], abs=2)
            assert run.sink.counted("gsr").lost == pytest.approx(true["gsr"], abs=1)
            losses = run.sink.array("quality")[:, 1]
            lost_s = true["bvp"] / 64
            assert np.nanmax(losses) == pytest.approx(lost_s / short_window, abs=0.05)
            run.assert_all_arrived(server.truth, "bvp", "acc")
            errors = server.truth.samples("bvp").times[: len(run.sink.times["bvp"])]
            errors = run.sink.times["bvp"] - errors
            assert errors.min() < -0.3
            assert abs(errors[-1]) < NEAR_S
    assert sum("estimated" in entry["event"] for entry in logs) == 1


async def test_a_share_of_lost_packets_shows_in_quality(
    world: World, running: Running, short_window: float
) -> None:
    with SteeredE4(world) as server:
        async with running(server.settings) as run:
            await run.until_more()
            server.lose_packets(0.3)
            # The first windows hold the time before, and that the wristband is worn.
            count = len(run.sink.rows["quality"])
            await run.until(lambda: len(run.sink.rows["quality"]) > count + 9)
            # Of a few packets a window: two windows alone were off by 0.18.
            assert run.sink.array("quality")[-6:, 1].mean() == pytest.approx(0.3, abs=0.12)
            run.assert_all_arrived(server.truth, "bvp")
            server.lose_packets(0.0)
            await run.until(lambda: run.sink.array("quality")[-1, 1] == 0)


async def test_what_was_measured_while_the_server_was_away_is_counted(
    world: World, running: Running, short_window: float
) -> None:
    with SteeredE4(world) as server:
        async with running(server.settings) as run:
            await run.until_more(rows=64)
            server.apply(Fault(FaultKind.REFUSE, 0.8))
            await run.until(run.has_reconnected)
            await run.until(lambda: run.sink.counted("bvp").lost)
            measured = server.truth.samples("bvp").times[run.places(server.truth)]
            (gap,) = [step for step in np.diff(measured) if step > 0.05]
            assert run.sink.counted("bvp").lost == pytest.approx(64 * gap, abs=6)
            run.assert_none_doubled(server.truth)
