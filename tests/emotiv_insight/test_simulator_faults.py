"""What can befall the virtual Cortex: connections, certificates, answers."""

from __future__ import annotations

import asyncio
import json
import ssl
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from websockets.asyncio.client import connect

from biosensor_gateway.devices.emotiv_insight.simulator import Circumstances, Leaf, Timing
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.world import World
from tests.emotiv_insight.steering import SteeredCortex
from tests.rigs.cortex_client import DEADLINE_S, CortexClient, CortexError

APP = (SteeredCortex.client_id, SteeredCortex.client_secret)
CREDENTIALS = dict(zip(("clientId", "clientSecret"), APP, strict=True))
FOREVER = float("inf")


@pytest.fixture
def world() -> Iterator[World]:
    with World() as world:
        yield world


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
