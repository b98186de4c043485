"""Every scenario of the vectors, played over a real connection to a scripted Cortex."""

from __future__ import annotations

import asyncio
import json
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import trustme
from structlog.testing import capture_logs

from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.emotiv_insight.driver import account
from biosensor_gateway.transports import websocket
from tests.rigs.polling import eventually

if TYPE_CHECKING:
    from tests.emotiv_insight.conftest import Answers, InsightRun, Running, ScriptedCortex


HEADSET_ID = "INSIGHT-12341234"
START = ["getCortexInfo", "getUserLogin", "hasAccessRight", "authorize", "queryHeadsets",
         "createSession", "subscribe"]  # fmt: skip
FILE = Path(__file__).parent / "vectors" / "emotiv_cortex.json"
# What is another layer's: test_websocket.py has the slow consumer.
ELSEWHERE = {"slow_consumer"}


def test_every_scenario_has_its_test() -> None:
    scenarios = {each["name"] for each in json.loads(FILE.read_text(encoding="utf-8"))["scenarios"]}
    tests = {name.removeprefix("test_") for name in globals() if name.startswith("test_")}
    assert scenarios - ELSEWHERE <= tests


async def stream_a_second(cortex: ScriptedCortex, run: InsightRun, rows: int = 128) -> float:
    """Send a second of EEG and wait for it; return when it began, in unix seconds."""
    await eventually(lambda: run.supervisor.is_connected)
    start = time.time() - 1
    already = len(run.sink.rows["eeg"])
    await cortex.say(*(cortex.eeg(number, start) for number in range(rows)))
    await eventually(run.sink.has(already + rows, "eeg"))
    return start


def numbers(run: InsightRun) -> list[int]:
    """Return which samples arrived, by the value that tells them apart."""
    return [round(float(row[0]) - 4200) for row in run.sink.rows["eeg"]]


def logged(logs: list[Any], words: str) -> list[Any]:
    return [entry for entry in logs if words in entry["event"]]


async def test_happy_path(cortex: ScriptedCortex, answers: Answers, running: Running) -> None:
    cortex.headsets = []

    async def found(cortex: ScriptedCortex, *call: Any) -> None:
        cortex.headsets = [cortex.headset("discovered")]
        await answers.usual(cortex, *call)

    async def connected(cortex: ScriptedCortex, *call: Any) -> None:
        await answers.usual(cortex, *call)
        cortex.headsets = [cortex.headset(memsRate=32)]
        await cortex.warn(104, {"behavior": "headset connected", "headsetId": HEADSET_ID})

    cortex.on("controlDevice", found, connected)
    # A column that nobody knows, and another order than usual.
    cortex.columns["eeg"] = ["NEW", *reversed(cortex.columns["eeg"])]
    async with running() as run:
        await eventually(run.is_streaming)
        values = [7.5, *reversed([5, 1, 4201.0, 4202.0, 4203.0, 4204.0, 4205.0, 1024.0, 1, []])]
        await cortex.say(cortex.data("eeg", values, time.time()))
        await eventually(run.sink.has(1, "eeg"))
    assert run.sink.rows["eeg"][0] == [4201, 4202, 4203, 4204, 4205]
    assert run.sink.rows["eeg_status"][0] == [5, 1, 1024, 1]
    await eventually(lambda: "updateSession" in cortex.methods)
    assert [each for each in cortex.methods if each not in START] == [
        "controlDevice", "controlDevice", "unsubscribe", "updateSession"
    ]  # fmt: skip
    by_method = {request.method: request.params for request in cortex.requests}
    assert by_method["createSession"]["status"] == "active"
    assert by_method["authorize"]["debit"] == 10
    assert "license" not in by_method["authorize"]
    assert by_method["updateSession"]["status"] == "close"
    assert by_method["updateSession"]["session"] == cortex.session


async def test_first_use(cortex: ScriptedCortex, answers: Answers, running: Running) -> None:
    refusal = answers.result({"accessGranted": False})
    cortex.on("hasAccessRight", *[refusal] * 3)
    cortex.on("requestAccess", refusal)
    with capture_logs() as logs:
        async with running() as run:
            await eventually(lambda: cortex.count("hasAccessRight") >= 2)
            assert run.supervisor.state is State.CONNECTING
            await cortex.warn(9, "granted")
            await eventually(run.is_streaming)
    assert cortex.count("requestAccess") == 1
    assert len(logged(logs, "click Approve there")) == 1


async def test_a_rejection_is_told_and_not_asked_for_again_at_once(
    cortex: ScriptedCortex, answers: Answers, running: Running
) -> None:
    refusal = answers.result({"accessGranted": False})
    cortex.on("hasAccessRight", *[refusal] * 999)
    cortex.on("requestAccess", *[refusal] * 999)
    async with running() as run:
        await eventually(lambda: "requestAccess" in cortex.methods)
        await cortex.warn(10, "rejected")
        await eventually(lambda: "rejected in EMOTIV Launcher" in run.error)
        assert State.BACKOFF in run.states
    assert "authorize" not in cortex.methods


async def test_no_user(
    cortex: ScriptedCortex,
    answers: Answers,
    running: Running,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Only the warning helps.
    cortex.on("getUserLogin", answers.result([]))
    with capture_logs() as logs:
        async with running() as run:
            monkeypatch.setattr(account, "ASK_EVERY_S", 3600.0)
            await eventually(lambda: bool(logged(logs, "nobody is logged in")))
            assert run.supervisor.state is State.CONNECTING
            await cortex.warn(2, "login")
            await eventually(run.is_streaming)
    assert len(logged(logs, "nobody is logged in")) == 1


async def test_no_user_for_longer_than_a_connection_waits(
    cortex: ScriptedCortex,
    answers: Answers,
    running: Running,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(account, "PATIENCE_S", 0.2)
    cortex.on("getUserLogin", *[answers.result([])] * 6)
    async with running() as run:
        await eventually(lambda: "log in there" in run.error)
        await eventually(run.is_streaming)
    assert State.BACKOFF in run.states


@pytest.mark.parametrize("code", [-32006, -32019, -32002, -32024])
async def test_eeg_license_missing(
    cortex: ScriptedCortex, answers: Answers, running: Running, code: int
) -> None:
    cortex.on("createSession", answers.error(code))
    cortex.failures = {"eeg": -32016}
    with capture_logs() as logs:
        async with running() as run:
            await eventually(run.is_streaming)
            await cortex.say(cortex.data("pow", [1.0] * 25, time.time()))
            await cortex.say(cortex.data("met", [True, 0.4, False, None, 0.2], time.time()))
            await cortex.say(cortex.data("dev", [4, 1.0, [4, 3, 2, 4, 1, 75], 88], time.time()))
            for name in ("pow", "met", "dev"):
                await eventually(run.sink.has(1, name))
            assert run.states.count(State.STREAMING) == 1
            assert "does not cover raw EEG" in run.error
            await cortex.each_connection(lambda socket: socket.close())
            await eventually(lambda: run.states.count(State.STREAMING) == 2)
            await eventually(lambda: "does not cover raw EEG" in run.error)
    sessions = [each.params["status"] for each in cortex.requests if each.method == "createSession"]
    assert sessions[:2] == ["active", "open"]
    # Once a connection.
    assert len(logged(logs, "does not cover raw EEG")) == 2
    assert run.sink.rows["eeg"] == []
    assert run.sink.rows["dev"][0] == [4, 1, 4, 3, 2, 4, 1, 75, 88]
    (met,) = run.sink.rows["met"]
    assert [round(float(value), 3) for value in met if not math.isnan(value)] == [0.2, 0.4]


async def test_partial_then_full(cortex: ScriptedCortex, running: Running) -> None:
    cortex.failures = {"eeg": -32016}
    async with running() as run:
        await eventually(run.is_streaming)
        cortex.failures = {}
        await cortex.say(cortex.data("pow", [1.0] * 25, time.time()))
        await eventually(run.sink.has(1, "pow"))
        # The licence has come, but nobody asks without being told to.
        assert cortex.count("subscribe") == 1
        await cortex.each_connection(lambda socket: socket.close())
        await eventually(lambda: run.states.count(State.STREAMING) == 2)
        await stream_a_second(cortex, run)


async def test_a_subscription_that_is_refused_as_a_whole_is_tried_without_eeg(
    cortex: ScriptedCortex, answers: Answers, running: Running
) -> None:
    cortex.on("subscribe", answers.error(-32016))
    async with running() as run:
        await eventually(run.is_streaming)
    asked = [each.params["streams"] for each in cortex.requests if each.method == "subscribe"]
    assert ["eeg" in streams for streams in asked] == [True, False]


@pytest.mark.parametrize("code", [-32014, -32015])
async def test_token_expired(
    cortex: ScriptedCortex,
    answers: Answers,
    running: Running,
    code: int,
) -> None:
    async with running() as run:
        start = await stream_a_second(cortex, run)
        cortex.on("subscribe", answers.error(code))
        number = 0
        # EEG alone stops, so the driver asks for it again; that needs a token.
        while cortex.count("subscribe") < 3:
            values = [number % 64, 0, *[0.5] * 10]
            await cortex.say(cortex.data("mot", values, start + 1 + number / 64))
            await asyncio.sleep(1 / 64)
            number += 1
        # What comes of a stream that stays away is tested elsewhere.
        run.sink.watch.expect({})
        await eventually(run.sink.has(number, "mot"))
        await stream_a_second(cortex, run)
        assert cortex.opened == run.supervisor.connections == 1
    tokens = [each.params["cortexToken"] for each in cortex.requests if each.method == "subscribe"]
    assert tokens == ["planted.token.one", "planted.token.one", "planted.token.two"]
    assert cortex.count("authorize") == 2


async def test_a_token_is_used_again_and_renewed_when_it_is_not_valid_any_more(
    cortex: ScriptedCortex, answers: Answers, running: Running
) -> None:
    async with running() as run:
        for connection in (1, 2, 3):
            await eventually(lambda n=connection: run.states.count(State.STREAMING) == n)
            if connection == 2:
                cortex.on("createSession", answers.error(-32014))
            await cortex.each_connection(lambda socket: socket.transport.abort())
        await eventually(lambda: run.states.count(State.STREAMING) == 3)
    assert cortex.count("authorize") == 2


@pytest.mark.parametrize("how", ["headset", "subscriptions", "session"])
async def test_headset_off(cortex: ScriptedCortex, running: Running, how: str) -> None:
    async with running() as run:
        await stream_a_second(cortex, run)
        session = cortex.session
        await cortex.warn(103, {"headsetId": "INSIGHT-99999999", "behavior": "another one"})
        await cortex.warn(0, {"sessionId": "another-session"})
        await cortex.warn(1, {"sessionId": "another-session"})
        await stream_a_second(cortex, run)
        assert run.states.count(State.STREAMING) == 1
        message = {"headset": {"headsetId": HEADSET_ID}}.get(how, {"sessionId": session})
        await cortex.warn({"headset": 103, "subscriptions": 0, "session": 1}[how], message)
        await eventually(lambda: run.states.count(State.STREAMING) == 2)
        assert State.DISCOVERING in run.states
        await stream_a_second(cortex, run)
    assert cortex.session != session


async def test_headset_off_virtual(cortex: ScriptedCortex, running: Running) -> None:
    with capture_logs() as logs:
        async with running() as run:
            await stream_a_second(cortex, run)
            cortex.headsets = []
            await eventually(lambda: "Cortex has lost the headset" in run.error)
            await eventually(lambda: "controlDevice" in cortex.methods)
            cortex.headsets = [cortex.headset()]
            await eventually(lambda: run.states.count(State.STREAMING) == 2)
            await stream_a_second(cortex, run)
    (said, *_) = logged(logs, "enabling again")
    assert {"eeg", "mot"} <= set(said["event"].replace(",", "").split())


async def test_scan_loop(cortex: ScriptedCortex, running: Running) -> None:
    cortex.headsets = []

    def scans() -> int:
        return cortex.count("controlDevice")

    async with running() as run:
        for scan in (1, 2):
            await eventually(lambda n=scan: scans() == n)
            await cortex.warn(142, {"behavior": "headset scanning finished"})
        await eventually(lambda: "finds no headset" in run.error)
        await eventually(lambda: scans() == 3)
        # Connected in the launcher, by hand.
        cortex.headsets = [cortex.headset()]
        await eventually(run.is_streaming)
        await stream_a_second(cortex, run)
    assert scans() == 3


async def test_no_scan_disturbs_the_headset_of_somebody_else(
    cortex: ScriptedCortex, running: Running
) -> None:
    async with running(headset="INSIGHT-99999999") as run:
        await eventually(lambda: "finds no headset INSIGHT-99999999" in run.error)
    assert "controlDevice" not in cortex.methods


MN8 = ("T7", "T8")
EPOC = ("AF3", "F7", "F3", "FC5", "T7", "P7", "O1", "O2", "P8", "T8", "FC6", "F4", "F8", "AF4")


@pytest.mark.parametrize(
    ("headset_id", "sensors", "said"),
    [
        ("MN8-12341234", MN8, "MN8-12341234 is not an Insight (2 electrodes: T7, T8);"),
        ("EPOCX-12341234", EPOC, "EPOCX-12341234 is not an Insight (14 electrodes: AF3, F7,"),
        ("EPOCFLEX-12341234", (), "EPOCFLEX-12341234 is not an Insight;"),
        # Whatever its id is: its own list decides.
        ("INSIGHT-12341234", EPOC, "INSIGHT-12341234 is not an Insight (14 electrodes:"),
    ],
)
async def test_a_headset_with_other_channels_is_refused_and_draws_no_session(
    cortex: ScriptedCortex,
    running: Running,
    headset_id: str,
    sensors: tuple[str, ...],
    said: str,
) -> None:
    cortex.headsets = [cortex.headset() | {"id": headset_id, "sensors": list(sensors)}]
    async with running(headset="") as run:
        await eventually(lambda: said in run.error)
        assert "set headset to an Insight" in run.error
        await eventually(lambda: run.states.count(State.BACKOFF) == 1)
    assert not {"createSession", "subscribe"} & set(cortex.methods)


async def test_other_headsets_in_reach_are_no_choice_to_make(
    cortex: ScriptedCortex, running: Running
) -> None:
    own = cortex.headset() | {"sensors": ["AF3", "AF4", "T7", "T8", "Pz"]}
    cortex.headsets = [own, {"id": "MN8-12341234", "status": "discovered", "sensors": []}]
    async with running(headset="") as run:
        await eventually(run.is_streaming)
        await stream_a_second(cortex, run)


async def test_data_before_subscribe_reply(
    cortex: ScriptedCortex, answers: Answers, running: Running
) -> None:
    async def data_first(cortex: ScriptedCortex, *call: Any) -> None:
        await cortex.say(*(cortex.eeg(number, time.time() - 1) for number in range(20)))
        await answers.usual(cortex, *call)
        await cortex.say(*(cortex.eeg(number, time.time() - 1) for number in range(20, 40)))

    cortex.on("subscribe", data_first)
    async with running() as run:
        await eventually(run.sink.has(40, "eeg"))
    assert numbers(run) == list(range(40))


async def lost_between(
    cortex: ScriptedCortex,
    running: Running,
    counters: tuple[int, int],
    later_samples: int,
) -> dict[str, int]:
    async with running() as run:
        await eventually(run.is_streaming)
        start = time.time()
        for counter, later_s in zip(counters, (0.0, later_samples / 128), strict=True):
            await asyncio.sleep(later_s)
            values: list[Any] = [counter, 0, *[4200.0] * 5, 0.0, 0, []]
            await cortex.say(cortex.data("eeg", values, start + later_s))
        await eventually(run.sink.has(2, "eeg"))
        assert run.sink.losses.get("eeg") == run.sink.losses.get("eeg_status")
        return dict(run.sink.losses)


async def test_counter_gap(cortex: ScriptedCortex, running: Running) -> None:
    losses = await lost_between(cortex, running, (10, 14), 4)
    assert losses == {"eeg": 3, "eeg_status": 3}


async def test_counter_gap_across_wrap(cortex: ScriptedCortex, running: Running) -> None:
    losses = await lost_between(cortex, running, (126, 1), 3)
    assert losses == {"eeg": 2, "eeg_status": 2}


async def test_counter_gap_whole_second(cortex: ScriptedCortex, running: Running) -> None:
    losses = await lost_between(cortex, running, (10, 11), 129)
    assert losses == {"eeg": 128, "eeg_status": 128}


async def test_interpolated_run(cortex: ScriptedCortex, running: Running) -> None:
    async with running() as run:
        await eventually(run.is_streaming)
        start = time.time() - 1
        await cortex.say(*(cortex.eeg(number, start, interpolated=int(5 <= number < 25))
                           for number in range(40)))  # fmt: skip
        await eventually(run.sink.has(40, "eeg_status"))
    assert numbers(run) == list(range(40))
    assert [bool(row[1]) for row in run.sink.rows["eeg_status"]] == [
        5 <= number < 25 for number in range(40)
    ]


async def test_server_restart(cortex: ScriptedCortex, answers: Answers, running: Running) -> None:
    async with running() as run:
        await stream_a_second(cortex, run)
        first = cortex.session
        await cortex.each_connection(lambda socket: socket.transport.abort())
        await cortex.stop()
        await eventually(lambda: "nothing listens there" in run.error)
        assert run.supervisor.state is not State.BACKOFF
        cortex.on("getCortexInfo", answers.error(-32122))
        cortex.on("createSession", answers.error(-32014))
        await cortex.start()
        await cortex.warn(23, "ready")
        await stream_a_second(cortex, run)
    assert cortex.session != first
    assert cortex.count("authorize") == 2
    assert numbers(run) == [*range(128), *range(128)]


@pytest.mark.parametrize("code", [1000, 1001, 1011])
async def test_server_close_1001(cortex: ScriptedCortex, running: Running, code: int) -> None:
    async with running() as run:
        await stream_a_second(cortex, run)
        await cortex.each_connection(lambda socket: socket.close(code))
        await eventually(lambda: run.states.count(State.STREAMING) == 2)
        await stream_a_second(cortex, run)
    assert State.BACKOFF not in run.states


async def test_tls_wrong_ca(cortex: ScriptedCortex, running: Running, tmp_path: Path) -> None:
    other = tmp_path / "other.pem"
    trustme.CA().cert_pem.write_to_path(other)
    async with running(ca_file=str(other)) as run:
        await eventually(lambda: State.BACKOFF in run.states)
        assert "certificate is not trusted" in run.error
        assert "set ca_file" in run.error
    assert cortex.opened == 0


@pytest.mark.parametrize("known", ["activated", "opened"])
async def test_second_client(
    cortex: ScriptedCortex,
    answers: Answers,
    running: Running,
    known: str,
) -> None:
    # Another application's session is no concern; an own one that is left over is used.
    cortex.session = "left-over"
    session = {"id": "left-over", "status": known, "headset": {"id": HEADSET_ID}}
    foreign = {"id": "foreign", "status": known, "headset": {"id": "INSIGHT-99999999"}}
    cortex.on("createSession", answers.error(-32005))
    cortex.on("querySessions", answers.result([foreign, session]))
    cortex.on("updateSession", answers.result({**session, "status": "activated"}))
    async with running() as run:
        await stream_a_second(cortex, run)
        updates = [each.params["status"] for each in cortex.requests
                   if each.method == "updateSession"]  # fmt: skip
    assert updates == ([] if known == "activated" else ["active"])
    (subscribe,) = [each for each in cortex.requests if each.method == "subscribe"]
    assert subscribe.params["session"] == "left-over"


async def test_half_open(
    cortex: ScriptedCortex,
    running: Running,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(websocket, "PING_INTERVAL_S", 0.1)
    monkeypatch.setattr(websocket, "PING_TIMEOUT_S", 0.1)
    async with running() as run:
        await eventually(run.is_streaming)
        # So impatient a ping may have ended a sound connection already.
        before = run.supervisor.connections
        await cortex.each_connection(lambda socket: socket.transport.pause_reading())
        await eventually(lambda: "the connection was closed" in run.error)
        await eventually(lambda: run.supervisor.connections > before)


async def test_unknown_warning_flood(cortex: ScriptedCortex, running: Running) -> None:
    with capture_logs() as logs:
        async with running() as run:
            await eventually(run.is_streaming)
            # It is quiet meanwhile, for as long as all that takes to come through.
            run.sink.watch.expect({})
            for code in range(1000, 2000):
                await cortex.warn(code, "future")
            await stream_a_second(cortex, run)
    assert 0 < len(logged(logs, "Cortex tells")) < 20
    assert numbers(run) == list(range(128))
    assert run.states.count(State.STREAMING) == 1
