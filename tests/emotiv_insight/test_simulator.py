"""The virtual Cortex, as a plain JSON-RPC client finds it, and what can befall it."""

from __future__ import annotations

import asyncio
import json
import ssl
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, cast

import pytest
from websockets.asyncio.client import connect

from biosensor_gateway.devices.emotiv_insight.simulator import (
    EPOC_X,
    INSIGHT_2,
    App,
    Circumstances,
    Leaf,
    Licence,
    Release,
    Timing,
    User,
)
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.world import World
from tests.emotiv_insight.steering import SteeredCortex
from tests.rigs.cortex_client import DEADLINE_S, CortexClient, CortexError

# The virtual Cortex, as a plain JSON-RPC client finds it.

APP = (SteeredCortex.client_id, SteeredCortex.client_secret)
CREDENTIALS = dict(zip(("clientId", "clientSecret"), APP, strict=True))
ALL = ("eeg", "mot", "pow", "met", "dev", "eq")
FAST = Timing(found_s=0.05, scan_s=0.1, connect_s=0.05, silence_s=0.3)
_VECTORS = json.loads((Path(__file__).parent / "vectors/emotiv_cortex.json").read_text("utf-8"))
VECTORS = {vector["name"]: vector for vector in _VECTORS["vectors"]}


@pytest.fixture
def world() -> Iterator[World]:
    with World() as world:
        yield world


def shape(value: Any) -> Any:
    """Keys and types of a message, without its values."""
    match value:
        case dict():
            fields = cast("dict[str, Any]", value)
            return {key: shape(inner) for key, inner in fields.items()}
        case list():
            return [shape(inner) for inner in cast("list[Any]", value)]
        case bool() | str() | None:
            return type(value)
        case _:
            return float


async def refusal(client: CortexClient, method: str, **params: Any) -> int:
    with pytest.raises(CortexError) as caught:
        await client.ask(method, **params)
    return caught.value.code


async def test_the_way_from_the_first_request_to_data(world: World) -> None:
    with SteeredCortex(world, timing=Timing(connect_s=1.0)) as cortex:
        headset = cortex.settings["headset"]
        async with CortexClient(cortex.settings) as client:
            assert (await client.ask("getCortexInfo"))["version"] == "4.8.32"
            (login,) = await client.ask("getUserLogin")
            assert login["currentOSUId"] == login["loggedInOSUId"]
            assert (await client.ask("hasAccessRight", **CREDENTIALS))["accessGranted"]
            token = await client.authorize(*APP)
            assert await client.ask("queryHeadsets") == []
            await client.ask("controlDevice", command="refresh")
            await client.until_warned(142)
            (found,) = await client.ask("queryHeadsets", id="INSIGHT-*")
            assert found["id"] == headset
            assert (found["status"], found["sensors"]) == ("discovered", [])
            assert (found["settings"]["eegRate"], found["settings"]["mode"]) == (0, "UNKNOWN")
            connecting = await client.send("controlDevice", command="connect", headset=headset)
            listed = await client.send("queryHeadsets")
            assert "error" not in await connecting
            assert (await listed)["result"][0]["status"] == "connecting"
            assert (await client.until_warned(104))["message"]["headsetId"] == headset
            (found,) = await client.ask("queryHeadsets")
            assert (found["status"], found["settings"]["memsRate"]) == ("connected", 64)
            own = {"cortexToken": token}
            session = await client.ask("createSession", **own, headset=headset, status="active")
            assert session["status"] == "activated"
            sync = {"headset": headset, "monotonicTime": 1.0, "systemTime": 2.0}
            assert (await client.ask("syncWithHeadsetClock", **sync))["headset"] == headset
            own["session"] = session["id"]
            subscribed = await client.ask("subscribe", **own, streams=[*ALL, "xyz"])
            assert [one["streamName"] for one in subscribed["success"]] == list(ALL)
            (failed,) = subscribed["failure"]
            assert (failed["streamName"], failed["code"]) == ("xyz", -32016)
            await client.until(lambda: all(client.data[stream] for stream in ALL))
            assert {m["sid"] for stream in ALL for m in client.data[stream]} == {session["id"]}
            ended = await client.ask("unsubscribe", **own, streams=["eeg", "xyz"])
            assert ended["success"] == [{"streamName": "eeg"}]
            assert [one["code"] for one in ended["failure"]] == [-32016]
            (own_session,) = await client.ask("querySessions", cortexToken=token)
            assert own_session["streams"] == sorted(set(ALL) - {"eeg"})
            closed = await client.ask("updateSession", **own, status="close")
            assert closed["status"] == "closed"
            assert await client.ask("querySessions", cortexToken=token) == []


async def test_replies_have_the_shape_of_the_vectors(world: World) -> None:
    with SteeredCortex(
        world,
        Circumstances(release=Release("3.8.1"), user=User(other_os_user=True)),
        model=INSIGHT_2,
        seed=2,
    ) as cortex:
        async with CortexClient(cortex.settings) as client:
            replies = {
                "res_getCortexInfo_v4": await (await client.send("getCortexInfo")),
                "res_getUserLogin_other_os_user": await (await client.send("getUserLogin")),
                "res_authorize": await (await client.send("authorize", **CREDENTIALS)),
            }
            token = replies["res_authorize"]["result"]["cortexToken"]
            await client.connect_headset()
            created = await (await client.send("createSession", cortexToken=token, status="active"))
            replies["res_createSession_activated_v3"] = created
            for name, reply in replies.items():
                assert shape(reply) == shape(VECTORS[name]["message"])
            known = VECTORS["res_createSession_activated_v3"]["message"]["result"]
            assert created["result"]["headset"] == known["headset"]
            assert created["result"]["performanceMetrics"] == known["performanceMetrics"]


@pytest.mark.parametrize(
    ("vector", "reported"), [("warn_104_headset_connected", 104), ("warn_142_scan_finished", 142)]
)
async def test_warnings_have_the_shape_of_the_vectors(
    world: World, vector: str, reported: int
) -> None:
    with SteeredCortex(world) as cortex:
        async with CortexClient(cortex.settings) as client:
            await client.connect_headset()
            warning = await client.until_warned(reported)
            assert shape(warning) == shape(VECTORS[vector]["message"]["warning"])


def test_the_credentials_are_offered_as_environment(world: World) -> None:
    with SteeredCortex(world, Circumstances(app=App("a", "b"))) as cortex:
        assert cortex.environment == {"EMOTIV_CLIENT_ID": "a", "EMOTIV_CLIENT_SECRET": "b"}


async def test_wrong_requests_are_told_by_their_codes(world: World) -> None:
    with SteeredCortex(world) as cortex:
        async with CortexClient(cortex.settings) as client:
            wrong = {"clientId": APP[0], "clientSecret": "wrong"}
            assert await refusal(client, "authorize", **wrong) == -32021
            assert await refusal(client, "authorize") == -32602
            assert await refusal(client, "authorize", **CREDENTIALS, license="other") == -32002
            assert await refusal(client, "noMethod") == -32601
            assert await refusal(client, "createSession", cortexToken="x") == -32014
            token = await client.authorize(*APP)
            own = {"cortexToken": token}
            assert await refusal(client, "createSession", **own, status="open") == -32001
            assert await refusal(client, "createSession", **own, status="new") == -32602
            assert await refusal(client, "subscribe", **own, session="x", streams=[]) == -32007
            for text in ("{", "[1,2]", '{"jsonrpc":"2.0","id":7}'):
                await client.socket.send(text)
            await client.until(lambda: len(client.replies) == 3)
            assert [(r["id"], r["error"]["code"]) for r in client.replies] == [
                (None, -32700), (None, -32600), (7, -32600)
            ]  # fmt: skip


async def test_any_error_of_the_vectors_can_be_answered(world: World) -> None:
    errors = [v["message"]["error"] for v in VECTORS.values() if v["category"] == "error"]
    with SteeredCortex(world) as cortex:
        cortex.answer_with_error("getUserLogin", *(error["code"] for error in errors))
        async with CortexClient(cortex.settings) as client:
            for error in errors:
                reply = await (await client.send("getUserLogin"))
                assert reply.keys() == {"jsonrpc", "id", "error"}
                assert shape(reply["error"]) == shape(error)
                assert reply["error"]["code"] == error["code"]
            assert await client.ask("getUserLogin")


async def test_an_expired_token_stops_requests_but_no_stream(world: World) -> None:
    with SteeredCortex(world) as cortex:
        async with CortexClient(cortex.settings) as client:
            token, _ = await client.begin(*APP, "eeg")
            cortex.expire_token()
            assert await refusal(client, "querySessions", cortexToken=token) == -32015
            await client.until_data("eeg", 10)
            token = await client.authorize(*APP)
            assert len(await client.ask("querySessions", cortexToken=token)) == 1


@pytest.mark.parametrize(
    ("licence", "active", "has_eeg"),
    [
        (Licence.NONE, -32006, False),
        (Licence.METRICS, None, False),
        (Licence.EEG, None, True),
        (Licence.EEG | Licence.METRICS, None, True),
    ],
)
async def test_a_licence_decides_about_eeg(
    world: World, licence: Licence, active: int | None, has_eeg: bool
) -> None:
    with SteeredCortex(world, Circumstances(user=User(licence=licence))) as cortex:
        async with CortexClient(cortex.settings) as client:
            token = await client.authorize(*APP)
            info = await client.ask("getLicenseInfo", cortexToken=token)
            assert ("eeg" in info["license"]["scopes"]) == has_eeg
            await client.connect_headset()
            status = "active"
            if active is not None:
                code = await refusal(client, "createSession", cortexToken=token, status="active")
                assert code == active
                status = "open"
            session = await client.ask("createSession", cortexToken=token, status=status)
            own = {"cortexToken": token, "session": session["id"]}
            result = await client.ask("subscribe", **own, streams=["eeg", "mot", "dev"])
            failed = [(one["streamName"], one["code"]) for one in result["failure"]]
            assert failed == ([] if has_eeg else [("eeg", -32016)])
            await client.until_data("mot", 3)
            cortex.license(Licence.EEG)
            await client.ask("updateSession", **own, status="active")
            await client.ask("subscribe", **own, streams=["eeg"])
            await client.until_data("eeg", 3)


async def test_a_session_ends_with_its_connection_and_there_is_one_an_app(world: World) -> None:
    with SteeredCortex(world, Circumstances(other_apps={"other": "o"})) as cortex:
        async with CortexClient(cortex.settings) as client:
            async with CortexClient(cortex.settings) as first:
                token, session = await first.begin(*APP, "mot")
                asked = {"cortexToken": token, "status": "open"}
                assert await refusal(client, "createSession", **asked) == -32005
                (known,) = await client.ask("querySessions", cortexToken=token)
                assert known["id"] == session
                other = await client.authorize("other", "o")
                created = await client.ask("createSession", cortexToken=other, status="active")
                own = {"cortexToken": other, "session": created["id"]}
                await client.ask("subscribe", **own, streams=["eeg"])
                await client.until_data("eeg", 3)
                await first.until_data("mot", 3)
                foreign = {"cortexToken": other, "session": session, "status": "close"}
                assert await refusal(client, "updateSession", **foreign) == -32007
            await client.until(lambda: cortex.client_count == 1)
            assert await client.ask("querySessions", cortexToken=token) == []
            await client.ask("createSession", **asked)


async def test_older_releases_list_headsets_without_a_scan(world: World) -> None:
    with SteeredCortex(
        world, Circumstances(release=Release("2.2.0"), neighbours=("EPOCX-01234567",))
    ) as cortex:
        async with CortexClient(cortex.settings) as client:
            listed = await client.ask("queryHeadsets")
            assert [one["id"] for one in listed] == ["INSIGHT-A1B2C3D4", "EPOCX-01234567"]
            (epoc,) = await client.ask("queryHeadsets", id="EPOCX-*")
            assert epoc["status"] == "discovered"


async def test_missing_bluetooth_is_noted_in_the_list(world: World) -> None:
    with SteeredCortex(world, Circumstances(bluetooth_permitted=False)) as cortex:
        async with CortexClient(cortex.settings) as client:
            reply = await (await client.send("queryHeadsets"))
            assert reply["attention"]["code"] == 31
            assert reply["result"] == []


@pytest.mark.parametrize("code", [100, 101, 102])
async def test_a_headset_cannot_always_be_connected_to(world: World, code: int) -> None:
    with SteeredCortex(world, timing=FAST) as cortex:
        async with CortexClient(cortex.settings) as client:
            await client.ask("controlDevice", command="refresh")
            await client.until_warned(142)
            cortex.fail_next_connect(code)
            asked = {"command": "connect", "headset": cortex.settings["headset"]}
            await client.ask("controlDevice", **asked)
            vector = VECTORS[f"warn_{code}_headset_connect_failed"]["message"]["warning"]
            assert shape(await client.until_warned(code)) == shape(vector)
            (headset,) = await client.ask("queryHeadsets")
            assert headset["status"] == "discovered"
            await client.ask("controlDevice", **asked)
            await client.until_warned(104)


async def test_an_unknown_headset_cannot_be_connected_to(world: World) -> None:
    with SteeredCortex(world) as cortex:
        async with CortexClient(cortex.settings) as client:
            await client.ask("controlDevice", command="connect", headset="INSIGHT-00000000")
            assert (await client.until_warned(100))["message"]["headsetId"] == "INSIGHT-00000000"


async def test_a_headset_that_is_switched_off_is_given_up_after_a_silence(world: World) -> None:
    with SteeredCortex(world, timing=FAST) as cortex:
        async with CortexClient(cortex.settings) as client:
            token, session = await client.begin(*APP, "eeg")
            await client.until_data("eeg")
            cortex.switch_headset_off()
            (headset,) = await client.ask("queryHeadsets")
            assert headset["status"] == "connected"
            await client.until_warned(1)
            ends = [code for code in client.warning_codes if code in {0, 1, 103}]
            assert ends == [103, 0, 1]
            assert client.warnings[-1]["message"]["sessionId"] == session
            assert await client.ask("queryHeadsets") == []
            cortex.switch_headset_on()
            assert await client.ask("queryHeadsets") == []
            client.warnings.clear()
            await client.connect_headset()
            session = (await client.ask("createSession", cortexToken=token, status="active"))["id"]
            await client.ask("subscribe", cortexToken=token, session=session, streams=["eeg"])
            await client.until_data("eeg")
            assert client.data["eeg"][-1]["sid"] == session


async def test_the_end_of_a_virtual_headset_is_never_told(world: World) -> None:
    with SteeredCortex(world, timing=FAST, is_virtual=True) as cortex:
        async with CortexClient(cortex.settings) as client:
            token, session = await client.begin(*APP, "eeg", "dev")
            await client.until_data("dev")
            cortex.switch_headset_off(virtual=True)
            sent = len(cortex.truth.samples("eeg").times)
            await client.until_warned(142)
            client.warnings.clear()
            await client.ask("controlDevice", command="refresh")
            await client.until_warned(142)
            (headset,) = await client.ask("queryHeadsets")
            assert (headset["status"], headset["isVirtual"]) == ("connected", True)
            assert len(cortex.truth.samples("eeg").times) == len(client.data["eeg"]) == sent
            own = {"cortexToken": token, "session": session}
            await client.ask("updateSession", **own, status="close")
            code = await refusal(client, "createSession", cortexToken=token, status="open")
            assert code == -32004
            assert client.warning_codes == [142]


async def test_a_headset_of_another_model_has_its_own_electrodes(world: World) -> None:
    with SteeredCortex(world, model=EPOC_X) as cortex:
        async with CortexClient(cortex.settings) as client:
            await client.begin(*APP, "eeg")
            (headset,) = await client.ask("queryHeadsets")
            assert headset["id"] == "EPOCX-A1B2C3D4"
            assert len(headset["sensors"]) == 14
            await client.until_data("eeg", 20)
            assert {len(row) for row in client.rows("eeg")} == {19}


# What can befall the virtual Cortex: connections, certificates, answers.
FOREVER = float("inf")


async def samples_before_reply(client: CortexClient, token: str, session: str) -> int:
    """Subscribe to EEG; return how many samples were there before the reply."""
    heard: list[int] = []
    reply = await client.send("subscribe", cortexToken=token, session=session, streams=["eeg"])
    reply.add_done_callback(lambda _: heard.append(len(client.data["eeg"])))
    await client.until(lambda: heard)
    assert (await reply)["result"]["success"]
    return heard[0]


@pytest.mark.parametrize("leaf", [Leaf.EXPIRED, Leaf.WRONG_NAME, Leaf.UNTRUSTED])
async def test_a_wrong_certificate_is_not_trusted(world: World, leaf: Leaf) -> None:
    with SteeredCortex(world, Circumstances(leaf=leaf)) as cortex:
        with pytest.raises(ssl.SSLCertVerificationError):
            async with CortexClient(cortex.settings):
                pass
        assert cortex.client_count == 0


async def test_the_authority_of_another_cortex_is_not_trusted(world: World) -> None:
    with SteeredCortex(world) as cortex, SteeredCortex(world) as other:
        settings = {**cortex.settings, "ca_file": other.settings["ca_file"]}
        with pytest.raises(ssl.SSLCertVerificationError):
            async with CortexClient(settings):
                pass


@pytest.mark.parametrize("lacks", [False, True])
async def test_strict_clients_want_the_key_usage_of_the_authority(
    world: World, lacks: bool
) -> None:
    with SteeredCortex(world, Circumstances(ca_without_key_usage=lacks)) as cortex:
        async with CortexClient(cortex.settings) as client:
            assert await client.ask("getUserLogin")
        strict = ssl.create_default_context(cafile=cortex.settings["ca_file"])
        strict.verify_flags |= ssl.VERIFY_X509_STRICT
        attempt = connect(cortex.settings["url"], ssl=strict, proxy=None)
        if lacks:
            with pytest.raises(ssl.SSLCertVerificationError, match="key usage"):
                await attempt
        else:
            await (await attempt).close()


async def test_stopping_removes_the_certificate_and_the_port(world: World) -> None:
    with ExitStack() as stack:
        settings = stack.enter_context(SteeredCortex(world)).settings
        ca_file = Path(settings["ca_file"])
        assert await asyncio.to_thread(ca_file.exists)
        async with CortexClient(settings) as client:
            await client.begin(*APP, "eeg")
            await asyncio.to_thread(stack.close)
            assert await client.until_closed() == 1001
    assert not await asyncio.to_thread(ca_file.exists)
    with pytest.raises(ConnectionRefusedError):
        await connect(settings["url"], ssl=ssl.create_default_context(), proxy=None)


async def test_a_half_open_link_answers_no_ping_and_sends_nothing(world: World) -> None:
    with SteeredCortex(world) as cortex:
        async with CortexClient(cortex.settings) as client:
            await client.begin(*APP, "eeg")
            await client.until_data("eeg", 3)
            cortex.apply(Fault(FaultKind.STALL, FOREVER))
            sent = len(cortex.truth.samples("eeg").times)
            pong = asyncio.ensure_future(await client.socket.ping())
            asked = await client.send("getUserLogin")
            opening = asyncio.create_task(CortexClient(cortex.settings).__aenter__())
            await client.until(lambda: cortex.truth.unsent_count("eeg") >= 30)
            assert len(cortex.truth.samples("eeg").times) == len(client.data["eeg"]) == sent
            assert not pong.done()
            assert not asked.done()
            assert not opening.done()
            cortex.clear(FaultKind.STALL)
            await asyncio.wait_for(pong, DEADLINE_S)
            assert (await asyncio.wait_for(asked, DEADLINE_S))["result"]
            await (await opening).__aexit__(None, None, None)
            await client.until_data("eeg", 3)
        lost = cortex.truth.unsent_count("eeg")
        counters = [row[0] for row in client.rows("eeg")]
        assert (counters[sent] - counters[sent - 1] - 1) % 128 == lost % 128


async def test_a_restart_forgets_tokens_sessions_and_the_headset(world: World) -> None:
    with SteeredCortex(world, timing=Timing(starting_s=6.0)) as cortex:
        async with CortexClient(cortex.settings) as client:
            token, _ = await client.begin(*APP, "eeg")
            cortex.apply(Fault(FaultKind.RESTART, FOREVER))
            assert await client.until_closed() == 1001
            with pytest.raises(ConnectionRefusedError):
                async with CortexClient(cortex.settings):
                    pass
        cortex.clear(FaultKind.RESTART)
        async with CortexClient(cortex.settings) as again:
            assert (await again.ask("getCortexInfo"))["version"]
            with pytest.raises(CortexError) as caught:
                await again.ask("queryHeadsets")
            assert caught.value.code == -32122
            await again.until_warned(23)
            assert await again.ask("queryHeadsets") == []
            with pytest.raises(CortexError) as caught:
                await again.ask("querySessions", cortexToken=token)
            assert caught.value.code == -32014
            await again.begin(*APP, "eeg")
            await again.until_data("eeg", 3)


async def test_a_port_opens_only_when_nothing_keeps_it_shut(world: World) -> None:
    with SteeredCortex(world) as cortex:
        cortex.apply(Fault(FaultKind.RESTART, FOREVER))
        cortex.apply(Fault(FaultKind.DROP, FOREVER))
        cortex.clear(FaultKind.RESTART)
        with pytest.raises(ConnectionRefusedError):
            async with CortexClient(cortex.settings):
                pass
        cortex.clear(FaultKind.DROP)
        async with CortexClient(cortex.settings) as client:
            assert await client.ask("getCortexInfo")


@pytest.mark.parametrize("code", [1000, 1001, 1011])
async def test_connections_are_closed_with_any_code(world: World, code: int) -> None:
    with SteeredCortex(world) as cortex:
        async with CortexClient(cortex.settings) as client:
            cortex.close_connections(code)
            assert await client.until_closed() == code
        async with CortexClient(cortex.settings) as again:
            assert await again.ask("getUserLogin")


async def test_data_may_come_before_the_reply(world: World) -> None:
    with SteeredCortex(world, Circumstances(data_before_reply=True)) as cortex:
        async with CortexClient(cortex.settings) as client:
            token, session = await client.begin(*APP)
            assert await samples_before_reply(client, token, session) > 0


async def test_answers_overtake_each_other(world: World) -> None:
    with SteeredCortex(world, Circumstances(reply_delays_s={"getUserLogin": 0.3})) as cortex:
        async with CortexClient(cortex.settings) as client:
            order: list[str] = []
            first = await client.send("getUserLogin")
            first.add_done_callback(lambda _: order.append("first"))
            second = await client.send("getCortexInfo")
            second.add_done_callback(lambda _: order.append("second"))
            await client.until(lambda: len(order) == 2)
            assert order == ["second", "first"]


async def test_answers_are_withheld_doubled_or_wrong(world: World) -> None:
    with SteeredCortex(world) as cortex:
        async with CortexClient(cortex.settings) as client:
            cortex.withhold_reply("getUserLogin")
            withheld = await client.send("getUserLogin")
            cortex.duplicate_reply("getCortexInfo")
            info = await client.ask("getCortexInfo")
            await client.until(lambda: client.replies)
            assert client.replies[0]["result"] == info
            cortex.answer_with_error("authorize", -32000, -32130)
            for code in (-32000, -32130):
                with pytest.raises(CortexError) as caught:
                    await client.ask("authorize", **CREDENTIALS)
                assert caught.value.code == code
            assert await client.authorize(*APP)
            assert not withheld.done()
        assert cortex.calls == ("getUserLogin", "getCortexInfo", *["authorize"] * 3)


async def test_any_message_can_be_sent_and_unknown_warnings_in_any_number(world: World) -> None:
    with SteeredCortex(world) as cortex:
        async with CortexClient(cortex.settings, max_size=2**22) as client:
            await client.begin(*APP, "eeg")
            # The end of the scan is told by a warning as well.
            await client.until_warned(142)
            client.warnings.clear()
            cortex.flood(1000)
            await client.until(lambda: client.warning_codes == [999] * 1000)
            huge = json.dumps({"warning": {"code": 998, "message": "x" * 2_000_000}})
            cortex.send_raw(huge)
            await client.until_warned(998)
            cortex.send_raw([huge[:9], huge[9:100], huge[100:].replace("x", "")])
            await client.until(lambda: client.warning_codes.count(998) == 2)
            await client.until_data("eeg", 10)
        assert len(client.data["eeg"]) >= 10


async def test_a_client_that_does_not_read_blocks_nobody(world: World) -> None:
    with SteeredCortex(world) as cortex:
        async with (
            CortexClient(cortex.settings, max_size=2**22) as slow,
            CortexClient(cortex.settings, max_size=2**22) as client,
        ):
            await slow.begin(*APP, "eeg")
            await slow.until_data("eeg")

            def holds_up() -> bool:
                # The library reads on by itself whenever its queue is short again.
                slow.socket.transport.pause_reading()
                return cortex.truth.unsent_count("eeg") > 10

            assert not holds_up()
            for _ in range(12):
                cortex.send_raw(" " * 2_000_000)
            await client.until(holds_up)
            assert await client.ask("getUserLogin")
            slow.socket.transport.resume_reading()
            assert await slow.ask("getUserLogin")
            await slow.until_data("eeg", 3)
            assert await client.ask("getUserLogin")
