"""The driver under its supervisor: what it emits, whom it chooses, what it asks for."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.driver import Found
from biosensor_gateway.devices.empatica_e4.driver import DRIVER, E4Settings
from biosensor_gateway.devices.empatica_e4.simulator import NumberFormat, Timing
from biosensor_gateway.simulation.world import World
from tests.empatica_e4.steering import SteeredE4

ID, OTHER = "9ff167", "cc34cd"
SAME_CONNECTION = "You've tried to connect to the device from the same connection"
REGULAR = ("bvp", "acc", "gsr", "st")
MEASURED = (*REGULAR, "hr", "ibi", "bat")
STAMP_LIMIT_S = 0.020

Running = Callable[[Mapping[str, Any]], AbstractAsyncContextManager[Any]]


async def test_every_stream_says_the_truth_at_the_time_of_measuring(
    world: World, running: Running
) -> None:
    with SteeredE4(
        world, timing=Timing(battery_interval_s=2), jitter_s=0.05, drift_ppm=200, seed=2
    ) as server:
        async with running(server.settings) as run:
            await run.until(run.sink.has(64 * 16, "bvp"))
            await run.until(run.sink.has(12, "ibi"))
            server.press_button()
            await run.until(lambda: run.sink.texts)
            run.assert_all_arrived(server.truth)
            for name in MEASURED:
                errors = run.stamp_errors(server.truth, name, after_s=10.0)
                assert len(errors) or name in ("hr", "ibi", "bat"), name
                assert np.all(np.abs(errors) < STAMP_LIMIT_S), (name, np.abs(errors).max())
            (pressed,) = server.truth.samples("tag").times
            assert abs(run.sink.times["tag"][0] - pressed) < STAMP_LIMIT_S
            assert run.sink.dropped_bytes == 0
            assert {run.sink.counted(name).lost for name in MEASURED} == {0}
            assert run.sink.texts == ["button"]
    assert server.requests[:3] == ("device_list", f"device_connect {ID}", "pause ON")
    assert server.requests[10:] == ("pause OFF", "device_disconnect")


@pytest.mark.parametrize(
    ("mark", "minus"), [(".", "-"), (",", "\u2212")], ids=["dot", "comma and U+2212"]
)
async def test_any_locale_is_read(world: World, running: Running, mark: str, minus: str) -> None:
    with SteeredE4(world, style=NumberFormat(mark, minus)) as server:
        async with running(server.settings) as run:
            await run.until_more("bvp", "acc", rows=70)
            run.assert_all_arrived(server.truth, "bvp", "acc")
            assert run.sink.array("bvp").min() < 0


async def test_manual_radio_is_connected_by_the_driver(world: World, running: Running) -> None:
    with SteeredE4(world, automatic=False) as server:
        async with running(server.settings) as run:
            await run.until_more()
            run.assert_all_arrived(server.truth, "bvp", "acc")
    asked = [each.split(maxsplit=1)[0] for each in server.requests]
    assert asked[:4] == [
        "device_list", "device_discover_list", "device_connect_btle", "device_connect",
    ]  # fmt: skip


async def test_a_wristband_of_another_account_is_not_tried(world: World, running: Running) -> None:
    with SteeredE4(world, allowed=False) as server:
        async with running(server.settings) as run:
            await run.until(lambda: State.BACKOFF in run.states)
            assert f"API key does not own wristband {ID}" in run.error
            assert not any(each.startswith("device_connect ") for each in server.requests)
            assert not any(each.startswith("device_connect_btle") for each in server.requests)
            server.allow()
            await run.until_more()


async def test_without_a_choice_the_only_wristband_is_taken(world: World, running: Running) -> None:
    with SteeredE4(world, device_id="CC34CD") as server:
        async with running({**server.settings, "device": ""}) as run:
            await run.until_more()
            run.assert_all_arrived(server.truth, "bvp")


@pytest.mark.parametrize("automatic", [True, False])
async def test_without_a_choice_several_wristbands_are_refused(
    world: World, running: Running, automatic: bool
) -> None:
    with SteeredE4(world, others=(OTHER,), automatic=automatic) as server:
        async with running({**server.settings, "device": ""}) as run:
            await run.until(lambda: State.BACKOFF in run.states)
            assert f"several wristbands ({ID}, {OTHER}); set `device`" in run.error
            assert run.supervisor.connections == 0


async def test_several_wristbands_of_one_server_do_not_mix(world: World, running: Running) -> None:
    with SteeredE4(world, others=(OTHER.upper(),)) as server:
        async with (
            running(server.settings) as first,
            running(server.settings_of(OTHER)) as second,
        ):
            await first.until_more(rows=40)
            await second.until_more(rows=40)
            server.turn_off()
            await first.until(lambda: State.DISCOVERING in first.states[1:])
            await second.until_more(rows=40)
            first.assert_all_arrived(server.truth, "bvp", "acc")
            second.assert_all_arrived(server.truth_of(OTHER), "bvp", "acc")
            assert second.supervisor.connections == 1


async def test_a_second_client_of_the_same_wristband_is_no_obstacle(
    world: World, running: Running, line_client: Any
) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as other:
        await asyncio.to_thread(other.begin)
        async with running(server.settings) as run:
            await run.until_more()
            assert run.places(server.truth)


async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Be a server for which the connection was bound before."""
    while request := (await reader.readline()).decode().split():
        match request:
            case ["device_list"]:
                reply = f"R device_list 1 | {ID} Empatica_E4\n"
            case ["device_connect", _]:
                reply = f"R device_connect ERR {SAME_CONNECTION}\n"
            case ["device_subscribe", stream, _]:
                reply = f"R device_subscribe {stream} OK\n"
            case ["pause", state]:
                reply = f"R pause {state}\nE4_Bvp 1680442024,5 {len(state)}\r\n"
            case _:
                break
        writer.write(reply.encode())
    writer.close()
    await writer.wait_closed()


async def test_a_connection_that_is_bound_already_goes_on(running: Running) -> None:
    async with await asyncio.start_server(answer, "127.0.0.1") as server:
        port = server.sockets[0].getsockname()[1]
        async with running({"port": port}) as run:
            await run.until(run.sink.has(1, "bvp"))
            assert run.supervisor.connections == 1


async def test_one_refused_stream_costs_only_itself(world: World, running: Running) -> None:
    with SteeredE4(world, timing=Timing(burst=1)) as server:
        server.refuse_stream("gsr")
        async with running(server.settings) as run:
            await run.until_more("bvp", "acc", "st", rows=4)
            assert not run.sink.rows["gsr"]
            assert run.supervisor.connections == 1
            assert "refuses gsr" in str(run.supervisor.last_error)


async def test_a_server_that_refuses_every_stream_is_left_alone(
    world: World, running: Running
) -> None:
    with SteeredE4(world) as server:
        for stream in ("acc", "bvp", "gsr", "ibi", "tmp", "bat", "tag"):
            server.refuse_stream(stream)
        async with running(server.settings) as run:
            await run.until(lambda: State.BACKOFF in run.states)
            assert "every stream" in run.error


async def test_stopping_unbinds(world: World, running: Running) -> None:
    with SteeredE4(world) as server:
        async with running(server.settings) as run:
            await run.until_more()
        await run.until(lambda: server.client_count == 0)
        assert server.requests[-1] == "device_disconnect"


async def test_the_wristbands_of_a_server_are_found(world: World) -> None:
    with SteeredE4(world, others=(OTHER,), automatic=False) as server:
        configured = E4Settings.model_validate(
            {"sensor": "empatica_e4", "unit": "1", **server.settings}
        )
        assert DRIVER.find is not None
        found: Sequence[Found] = await DRIVER.find([configured])
        assert [each.settings["device"] for each in found] == [ID, OTHER]
        assert {each.settings["port"] for each in found} == {server.settings["port"]}
        assert all(E4Settings.model_validate({"sensor": "empatica_e4", **each.settings})
                   for each in found)  # fmt: skip
