"""The driver under its supervisor: what can befall radio and server, and what is lost."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractAsyncContextManager
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from structlog.testing import capture_logs

from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.empatica_e4 import driver as driver_module
from biosensor_gateway.devices.empatica_e4.driver import emitter as emitter_module
from biosensor_gateway.devices.empatica_e4.simulator import Timing
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.world import World
from tests.empatica_e4.steering import SteeredE4

# The driver under its supervisor, and what can befall radio, server and lines.

ID = "9ff167"
FOREVER = float("inf")
REGULAR = ("bvp", "acc", "gsr", "st")
# Without a rival for the processor it is a hundredth of that.
NEAR_S = 0.15
# A packet on which stamps hang may be held up; that is taken off in the seconds after it.
LATEST_S, SETTLED_S = 2.0, 3.0
SETTLED_ROWS = round(64 * SETTLED_S)
Running = Callable[[Mapping[str, Any]], AbstractAsyncContextManager[Any]]


def assert_in_place(errors: NDArray[np.float64]) -> None:
    """Stamps are nowhere early, hardly late, and right at the end, long after all that befell."""
    assert errors.min() > -NEAR_S
    assert errors.max() < LATEST_S
    assert np.abs(errors[-16:]).max() < NEAR_S


async def test_a_lost_radio_link_that_comes_back_needs_no_new_connection(
    world: World, running: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "RADIO_GRACE_S", 10.0)
    with SteeredE4(world, timing=Timing(beat_delay_s=0.5)) as server:
        with capture_logs() as logs:
            async with running(server.settings) as run:
                await run.until_more(rows=64)
                server.apply(Fault(FaultKind.DROP, 1.2))
                await run.until(lambda: server.truth.unsent_count("bvp"))
                await run.until_more(rows=SETTLED_ROWS)
                assert run.supervisor.connections == 1
                run.assert_all_arrived(server.truth, "bvp", "acc")
                # Of a new reference, and yet in place: the pause is in the stamps.
                assert_in_place(run.stamp_errors(server.truth, "bvp"))
                assert np.diff(run.sink.times["bvp"]).max() > 0.8
                run.assert_none_doubled(server.truth)
        assert not any(each.startswith("device_list") for each in server.requests[1:])
    told = [entry["event"] for entry in logs if entry.get("device") == ID]
    assert told == ["the wristband is out of reach of its dongle", "the wristband is back"]


async def test_a_manual_radio_that_is_back_is_connected_after_the_grace(
    world: World, running: Running
) -> None:
    with SteeredE4(world, automatic=False) as server:
        async with running(server.settings) as run:
            await run.until_more()
            server.apply(Fault(FaultKind.DROP, 0.2))
            await run.until(run.has_reconnected)
            await run.until_more()
            run.assert_none_doubled(server.truth)
    assert sum(each.startswith("device_connect_btle") for each in server.requests) == 2


async def test_a_wristband_that_is_turned_off_is_awaited(world: World, running: Running) -> None:
    with SteeredE4(world) as server:
        async with running(server.settings) as run:
            await run.until_more()
            before = len(server.truth.samples("bvp").times)
            server.turn_off()
            await run.until(lambda: "switch it on" in run.error)
            # Not even what came in one piece with the event is lost.
            assert len(run.sink.rows["bvp"]) >= before
            assert State.BACKOFF not in run.states
            server.turn_on()
            await run.until_more()
            run.assert_all_arrived(server.truth, "bvp", "acc")
            assert {run.sink.counted(name).lost for name in REGULAR} == {0}


async def test_what_comes_in_one_piece_with_an_event_counts(world: World, running: Running) -> None:
    with SteeredE4(world) as server:
        async with running(server.settings) as run:
            await run.until_more()
            tag = f"E4_Tag {time.time():.5f}\r\n"
            server.send_raw(f"{tag}R device {ID} turned off via button\n".encode())
            await run.until(lambda: "switched off" in run.error)
            assert run.sink.texts == ["button"]
            # Another wristband's radio is no concern of this one's.
            await run.until(run.has_reconnected)
            server.send_raw(b"R device cc34cd turned off via button\n")
            await run.until_more()
            assert run.supervisor.connections == 2


async def test_a_stalled_server_is_asked_and_then_left(world: World, running: Running) -> None:
    with SteeredE4(world) as server:
        async with running(server.settings) as run:
            await run.until_more()
            server.apply(Fault(FaultKind.STALL, FOREVER))
            await run.until(lambda: "says nothing any more" in run.error)
            server.clear(FaultKind.STALL)
            await run.until(run.has_reconnected)
            await run.until_more()
            run.assert_none_doubled(server.truth)


def end_radio_link(line_client: Any, server: SteeredE4) -> None:
    with line_client(server.settings) as other:
        assert other.ask(f"device_disconnect_btle {ID}").endswith("OK\n")


async def test_a_server_that_answers_without_data_is_left_too(
    world: World, running: Running, line_client: Any
) -> None:
    with SteeredE4(world) as server:
        async with running(server.settings) as run:
            await run.until_more()
            # Another program ends the radio link, of which nobody is told.
            await asyncio.to_thread(end_radio_link, line_client, server)
            await run.until(lambda: "no data of" in run.error and "connecting again" in run.error)
            await run.until(run.has_reconnected)
            await run.until_more()


async def test_a_short_hold_up_is_waited_for_and_its_backlog_misleads_no_stamp(
    world: World, running: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What is silent for that long is asked, and answers once the line goes on.
    monkeypatch.setattr(driver_module, "LIST_TIMEOUT_S", 10.0)
    with SteeredE4(world, seed=9) as server:
        async with running(server.settings) as run:
            await run.until_more(rows=SETTLED_ROWS + 32)
            server.tear_line(1.5)
            await run.until_more(rows=192)
            assert run.supervisor.connections == 1
            run.assert_all_arrived(server.truth, "bvp", "acc", "st")
            errors = run.stamp_errors(server.truth, "bvp", after_s=SETTLED_S)
            assert np.abs(errors).max() < NEAR_S
            assert run.sink.dropped_bytes == 0


async def test_lines_that_come_twice_glued_or_in_pieces(world: World, running: Running) -> None:
    with SteeredE4(world) as server:
        async with running(server.settings) as run:
            for _ in range(5):
                server.duplicate_line()
                server.tear_line(0.05)
                server.tear_line(0.05, in_line_end=True)
                await run.until_more()
            run.assert_all_arrived(server.truth, "bvp", "acc")
            assert run.sink.dropped_bytes == 0
            server.glue_lines()
            await run.until(lambda: run.sink.dropped_bytes)
            await run.until_more()
            run.assert_all_arrived(server.truth, "bvp", "acc")


async def test_a_connection_that_ends_within_a_line_is_begun_again(
    world: World, running: Running
) -> None:
    with SteeredE4(world) as server:
        async with running(server.settings) as run:
            await run.until_more()
            server.close_within_line()
            await run.until(run.has_reconnected)
            await run.until_more()
            run.assert_none_doubled(server.truth)
            run.assert_all_arrived(server.truth, "bvp")
            assert run.sink.dropped_bytes > 0


async def test_an_answer_that_never_comes_begins_again(world: World, running: Running) -> None:
    with SteeredE4(world) as server:
        server.withhold_reply("device_subscribe")
        async with running(server.settings) as run:
            await run.until(lambda: "no answer to device_subscribe" in run.error)
            await run.until_more()


@pytest.mark.parametrize("obey", [True, False])
async def test_a_server_that_never_answers_pause_does_without(
    world: World, running: Running, obey: bool
) -> None:
    with SteeredE4(world) as server:
        server.never_answer("pause", obey=obey)
        with capture_logs() as logs:
            async with running(server.settings) as run:
                await run.until_more("bvp", "acc", "st")
                assert run.error == ""
                server.close_connections()
                await run.until(run.has_reconnected)
                await run.until_more()
            run.assert_none_doubled(server.truth)
        assert run.states.count(State.STREAMING) == 2
        assert sum("does not answer pause" in entry["event"] for entry in logs) == 1


async def test_an_empty_list_is_waited_for(world: World, running: Running) -> None:
    with SteeredE4(world) as server:
        server.empty_list(FOREVER)
        async with running(server.settings) as run:
            await run.until(lambda: "sees no wristband" in run.error)
            server.empty_list(0.0)
            await run.until_more()


@pytest.mark.parametrize("seconds", [3600.0, -3600.0])
async def test_the_clock_of_the_server_may_be_set(
    world: World, running: Running, seconds: float
) -> None:
    with SteeredE4(world) as server:
        async with running(server.settings) as run:
            await run.until_more(rows=64)
            server.jump_clock(seconds)
            await run.until_more(rows=SETTLED_ROWS)
            run.assert_all_arrived(server.truth, "bvp", "acc")
            assert_in_place(run.stamp_errors(server.truth, "bvp"))
            assert run.supervisor.connections == 1


# The driver under its supervisor, and samples that the radio or a pause costs.
@pytest.fixture
def short_window(monkeypatch: pytest.MonkeyPatch) -> float:
    """Estimate losses every two seconds."""
    monkeypatch.setattr(emitter_module, "WINDOW_S", 2.0)
    return 2.0


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
