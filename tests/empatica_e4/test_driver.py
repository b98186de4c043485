"""The driver under its supervisor: what it emits, whom it chooses, what it asks for."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from structlog.testing import capture_logs

from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.driver import Found
from biosensor_gateway.devices.empatica_e4 import driver as driver_module
from biosensor_gateway.devices.empatica_e4.driver import DRIVER, E4Settings
from biosensor_gateway.devices.empatica_e4.driver import emitter as emitter_module
from biosensor_gateway.devices.empatica_e4.simulator import NumberFormat, Timing
from biosensor_gateway.simulation.faults import Fault, FaultKind
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


async def test_what_comes_with_a_refused_stream_is_said_too(world: World, running: Running) -> None:
    with SteeredE4(world, timing=Timing(burst=1)) as server:
        server.refuse_stream("ibi")
        server.refuse_stream("tag")
        async with running(server.settings) as run:
            await run.until_more("bvp", rows=4)
            said = str(run.supervisor.last_error)
    assert "refuses hr, ibi, tag (the server says" in said


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


# The driver under its supervisor: what can befall radio and server, and what is lost.

# The driver under its supervisor, and what can befall radio, server and lines.

FOREVER = float("inf")
# Without a rival for the processor it is a hundredth of that.
NEAR_S = 0.15
# A packet on which stamps hang may be held up; that is taken off in the seconds after it.
LATEST_S, SETTLED_S = 2.0, 3.0
SETTLED_ROWS = round(64 * SETTLED_S)


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
    assert told == ["the wristband is out of range of its dongle", "the wristband is back"]


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
            await run.until(lambda: "no longer sends anything" in run.error)
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


# The virtual E4 server: its answers, its data, and what can befall both.

# The virtual E4 server: what it answers, to whom, and how it writes numbers.

NOT_BOUND = "ERR You are not connected to any device\n"


def scenario(vectors: dict[str, Any], name: str) -> list[str]:
    (found,) = (each for each in vectors["scenarios"] if each["name"] == name)
    steps: list[str] = found["steps"]
    return steps


def play(client: Any, steps: list[str]) -> None:
    """Say what the client says and expect the server's lines to the last byte."""
    for step in steps:
        if step.startswith("> "):
            client.send(step[2:])
        elif step.endswith("..."):
            line = client.read()
            assert line.startswith(step[2:-3].encode())
            assert line.endswith(b"\r\n")
        elif step.startswith("< "):
            assert client.read() == step[2:].encode() + b"\n"


@pytest.mark.parametrize(
    ("name", "automatic", "is_bound"),
    [("happy_path", True, False), ("manual_btle", False, False), ("second_binding", True, True)],
)
def test_a_conversation_is_the_same_to_the_byte(
    world: World, line_client: Any, vectors: Any, name: str, automatic: bool, is_bound: bool
) -> None:
    with (
        SteeredE4(world, automatic=automatic) as server,
        line_client(server.settings) as client,
    ):
        if is_bound:
            client.begin(streams="")
        play(client, scenario(vectors, name))


def test_a_wristband_of_another_owner_to_the_byte(
    world: World, line_client: Any, vectors: Any
) -> None:
    with (
        SteeredE4(world, device_id="7a3166", allowed=False) as server,
        line_client(server.settings) as client,
    ):
        play(client, scenario(vectors, "not_allowed"))
        assert client.ask("device_list") == "R device_list 0\n"
        refusal = client.ask("device_connect_btle 7a3166 208")
        assert refusal == (
            "R device_connect_btle ERR The device is not registered with the API key\n"
        )
        server.allow()
        assert client.ask("device_list") == "R device_list 1 | 7a3166 Empatica_E4\n"


def test_unbinding_closes_the_connection_to_the_byte(
    world: World, line_client: Any, vectors: Any
) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        client.begin(streams="")
        play(client, scenario(vectors, "disconnect_closes_tcp"))
        assert client.read() == b""
        with line_client(server.settings) as again:
            assert again.ask("device_list") == f"R device_list 1 | {ID} Empatica_E4\n"


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("device_subscribe bvp ON", NOT_BOUND),
        ("pause ON", NOT_BOUND),
        ("device_disconnect", "ERR No connected device.\n"),
        ("device_connect ffffff", "ERR The device requested for connection is not available.\n"),
        ("device_connect", "ERR The device requested for connection is not available.\n"),
        ("device_connect_btle ffffff", "ERR The device has not been discovered yet\n"),
        ("device_disconnect_btle ffffff", "ERR The device is not connected over btle\n"),
        ("server_status", "OK\n"),
        ("make_coffee", "ERR Unknown command\n"),
    ],
)
def test_what_cannot_be_done_is_an_error(
    world: World, line_client: Any, request_: str, answer: str
) -> None:
    with SteeredE4(world) as server, line_client(server.settings) as client:
        assert client.ask(request_) == f"R {request_.split(maxsplit=1)[0]} {answer}"


def test_numbers_are_written_as_in_the_vectors(vectors: dict[str, Any]) -> None:
    lines = [each["message"] for each in vectors["vectors"] if each["category"] == "data"]
    texts = [text for line in lines for text in line.split()[1:]]
    assert len(texts) > 15
    for text in texts:
        style = NumberFormat("," if "," in text else ".", "\u2212" if "\u2212" in text else "-")
        number = float(text.replace(",", ".").replace("\u2212", "-"))
        assert text == (style.stamp(number) if number > 1e9 else style.value(number))
