"""Links that break, hang and come back on the virtual radio, through a plain BleakClient."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any

import pytest
from bleak import BleakClient, BleakScanner
from bleak.exc import BleakError

from tests.rigs.polling import until
from tests.rigs.probe import EVENT, FLOW, NOTE, SERIAL, Probe


async def test_a_lost_link_calls_back_once(probe: Probe) -> None:
    gone: list[BleakClient] = []
    client = BleakClient(probe.address, gone.append)
    await client.connect()
    probe.drop()
    await until(lambda: gone)
    assert gone == [client]
    assert not client.is_connected
    with pytest.raises(BleakError):
        _ = client.services
    with pytest.raises(BleakError):
        await client.stop_notify(FLOW)
    await client.disconnect()
    assert gone == [client]


async def test_a_local_disconnect_calls_back_before_it_returns(probe: Probe) -> None:
    gone: list[BleakClient] = []
    client = BleakClient(probe.address, gone.append)
    await client.connect()
    await client.disconnect()
    assert gone == [client]
    assert not client.is_connected
    await until(lambda: not probe.peripheral.connected)
    await client.disconnect()


async def test_a_pending_request_fails_after_the_callback(probe: Probe) -> None:
    events: list[str] = []
    async with BleakClient(probe.address, lambda _: events.append("lost")) as client:
        probe.set_stalled(True)
        requests = [asyncio.create_task(client.read_gatt_char(SERIAL)) for _ in range(3)]
        for request in requests:
            request.add_done_callback(lambda _: events.append("failed"))
        await asyncio.sleep(0.05)
        probe.drop()
        outcomes = await asyncio.gather(*requests, return_exceptions=True)
    assert [type(outcome) for outcome in outcomes] == [BleakError] * 3
    assert events == ["lost", "failed", "failed", "failed"]


@pytest.mark.parametrize("is_switched_off", [False, True])
async def test_what_was_sent_before_the_drop_arrives(probe: Probe, is_switched_off: bool) -> None:
    sent = [count.to_bytes(2, "big") * 100 for count in range(700)]
    got: list[bytes] = []
    gone = asyncio.Event()
    async with BleakClient(probe.address, lambda _: gone.set()) as client:
        await client.start_notify(FLOW, lambda _, data: got.append(bytes(data)))

        async def burst_then_drop() -> list[bool]:
            taken = [await probe.peripheral.notify(probe.flow, value) for value in sent]
            if is_switched_off:
                await probe.peripheral.power_off()
            else:
                probe.peripheral.drop()
            return [*taken, await probe.peripheral.notify(probe.flow, b"too late")]

        taken = probe.radio.world.await_(burst_then_drop())
        await gone.wait()
    assert taken == [True] * len(sent) + [False]
    assert got == sent


async def test_a_stall_is_silence_on_a_standing_link(probe: Probe) -> None:
    got: list[bytes] = []
    async with BleakClient(probe.address) as client:
        await client.start_notify(FLOW, lambda _, data: got.append(bytes(data)))
        probe.set_stalled(True)
        assert probe.notify(probe.flow, b"lost") == [False]
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await client.write_gatt_char(NOTE, b"late", response=True)
        assert client.is_connected
        assert probe.notes == []
        probe.set_stalled(False)
        assert await client.read_gatt_char(SERIAL) == b"0815"
        assert probe.notes == [b"late"]
        assert probe.notify(probe.flow, b"heard") == [True]
        await until(lambda: got)
    assert got == [b"heard"]


async def test_an_indication_ends_with_the_link(probe: Probe) -> None:
    async with BleakClient(probe.address) as client:
        await client.start_notify(EVENT, lambda _, __: None)
        probe.set_stalled(True)
        assert not await probe.begin_notify(probe.event, b"never sent")
        probe.set_stalled(False)

        async def hang_after_sending() -> asyncio.Task[bool]:
            sending = asyncio.ensure_future(probe.peripheral.notify(probe.event, b"unconfirmed"))
            await asyncio.sleep(0)
            probe.peripheral.stalled = True
            return sending

        sending = probe.radio.world.await_(hang_after_sending())
        probe.drop()
        await until(sending.done)
        assert sending.result() is False


@pytest.mark.parametrize("end", ["drop", "power_off", "disconnect"])
async def test_an_indication_that_arrived_was_sent_whatever_its_confirmation(
    probe: Probe, end: str
) -> None:
    got: list[bytes] = []

    async def hang_after_putting_out() -> list[asyncio.Task[bool]]:
        values = b"unconfirmed", b"behind it"
        sending = [asyncio.ensure_future(probe.peripheral.notify(probe.event, v)) for v in values]
        for _ in values:
            await asyncio.sleep(0)
        probe.peripheral.stalled = True
        return sending

    async with BleakClient(probe.address) as client:
        await client.start_notify(EVENT, lambda _, data: got.append(bytes(data)))
        sending = probe.radio.world.await_(hang_after_putting_out())
        await until(lambda: got)
        assert not any(each.done() for each in sending), "the confirmation was held up"
        match end:
            case "drop":
                probe.drop()
            case "power_off":
                # Who switches it off ends the senders next.
                probe.power_off()
                assert all(each.done() for each in sending)
            case _:
                await client.disconnect()
        await until(lambda: all(each.done() for each in sending))
    assert got == [b"unconfirmed"]
    assert [each.result() for each in sending] == [True, False]


@pytest.mark.parametrize("patience_s", [count * 0.01 for count in range(12)])
async def test_giving_up_at_any_moment_leaves_no_connection(
    probe: Probe, patience_s: float
) -> None:
    device = await BleakScanner.find_device_by_name("Probe 1", timeout=20)
    assert device
    impatient = BleakClient(device)
    try:
        async with asyncio.timeout(patience_s):
            await impatient.connect()
    except TimeoutError:
        assert not impatient.is_connected
    else:
        await impatient.disconnect()
    async with BleakClient(device, timeout=20) as client:
        assert await client.read_gatt_char(SERIAL) == b"0815"


async def test_a_request_given_up_does_not_harm_the_next(probe: Probe) -> None:
    async with BleakClient(probe.address) as client:
        probe.set_stalled(True)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.1):
                await client.read_gatt_char(SERIAL)
        following = asyncio.create_task(client.read_gatt_char(FLOW))
        await asyncio.sleep(0.05)
        probe.set_stalled(False)
        assert await following == b"still"


async def test_switching_the_radio_off_loses_the_links(probe: Probe) -> None:
    gone = asyncio.Event()
    client = BleakClient(probe.address, lambda _: gone.set())
    await client.connect()
    probe.radio.available = False
    await gone.wait()
    assert not client.is_connected
    await until(lambda: not probe.peripheral.connected)
    probe.radio.available = True
    async with BleakClient(probe.address, timeout=20) as again:
        assert await again.read_gatt_char(SERIAL) == b"0815"


def run_in_loop_of_its_own(probe: Probe, call: Coroutine[Any, Any, None]) -> None:
    with asyncio.Runner(loop_factory=probe.radio.world.clock.new_event_loop) as runner:
        runner.run(call)


async def test_clients_of_several_loops_share_the_radio(probe: Probe) -> None:
    other = Probe(probe.radio, "A0:9E:1A:00:00:02", "Probe 2")
    other.power_on()
    read: list[bytes] = []

    async def elsewhere() -> None:
        async with BleakClient(other.address) as client:
            read.append(bytes(await client.read_gatt_char(SERIAL)))

    async with BleakClient(probe.address) as client:
        await asyncio.to_thread(run_in_loop_of_its_own, probe, elsewhere())
        assert await client.read_gatt_char(SERIAL) == b"0815"
    assert read == [b"0815"]
