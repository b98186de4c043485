"""The virtual radio through plain bleak: what a scanner hears, and GATT."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import Coroutine
from typing import Any

import bleak
import bleak.backends.scanner
import pytest
from bleak import BleakClient, BleakScanner
from bleak.exc import (
    BleakCharacteristicNotFoundError,
    BleakError,
    BleakGATTProtocolError,
)

from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.central import GattLink
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.world import World
from tests.rigs.polling import until
from tests.rigs.probe import EVENT, FLOW, NOTE, REFUSAL, SECRET, SERIAL, SERVICE, Probe

# GATT through a plain BleakClient on the virtual radio.

CLIENT_CONFIGURATION = "00002902-0000-1000-8000-00805f9b34fb"


async def test_the_gatt_table_is_the_devices(probe: Probe) -> None:
    async with BleakClient(probe.address) as client:
        service = client.services.get_service(SERVICE)
        assert service
        table = {each.uuid: set(each.properties) for each in service.characteristics}
        flow = client.services.get_characteristic(FLOW)
        assert flow
        assert [each.uuid for each in flow.descriptors] == [CLIENT_CONFIGURATION]
    writes = {"read", "write", "write-without-response"}
    assert table == {
        SERIAL: {"read"},
        NOTE: writes,
        FLOW: {"notify", "read"},
        EVENT: {"indicate"},
        SECRET: writes | {"notify"},
        REFUSAL: writes,
    }


async def test_two_thousand_notifications_arrive_in_order(probe: Probe) -> None:
    sent = [count.to_bytes(2, "big") * 100 for count in range(2000)]
    got: list[bytes] = []
    async with BleakClient(probe.address) as client:
        await client.start_notify(FLOW, lambda _, data: got.append(bytes(data)))
        assert all(probe.notify(probe.flow, *sent))
        await until(lambda: len(got) >= len(sent))
    assert got == sent


@pytest.mark.parametrize("what", ["_discover", "read"])
async def test_who_gave_up_hears_of_no_error_later(
    world: World, probe: Probe, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    begun: list[GattLink] = []

    async def endless(link: GattLink, *_: Any) -> bytes:
        begun.append(link)
        return await link.request(asyncio.get_running_loop().create_future())

    monkeypatch.setattr(GattLink, what, endless)
    reported: list[dict[str, Any]] = []
    for loop in (asyncio.get_running_loop(), world.loop):
        loop.set_exception_handler(lambda _, context: reported.append(context))
    client = BleakClient(probe.address)
    if what == "read":
        await client.connect()
    given_up = asyncio.create_task(
        client.read_gatt_char(SERIAL) if what == "read" else client.connect()
    )
    await until(lambda: begun)
    given_up.cancel()
    with pytest.raises(asyncio.CancelledError):
        await given_up
    await client.disconnect()
    await until(lambda: begun[0].lost)
    await asyncio.sleep(0.1)
    gc.collect()
    await asyncio.sleep(0.1)
    assert reported == []


async def test_an_indication_returns_when_it_is_confirmed(probe: Probe) -> None:
    got: list[bytes] = []
    async with BleakClient(probe.address) as client:
        await client.start_notify(EVENT, lambda _, data: got.append(bytes(data)))
        assert probe.notify(probe.event, b"one", b"two") == [True, True]
        await until(lambda: len(got) == 2)
    assert got == [b"one", b"two"]


async def test_what_a_characteristic_does_not_offer_is_refused(probe: Probe) -> None:
    async with BleakClient(probe.address) as client:
        with pytest.raises(BleakGATTProtocolError) as caught:
            await client.read_gatt_char(EVENT)
        assert caught.value.code == 0x02
        with pytest.raises(BleakGATTProtocolError) as caught:
            await client.write_gatt_char(SERIAL, b"1", response=True)
        assert caught.value.code == 0x03
        with pytest.raises(BleakCharacteristicNotFoundError):
            await client.read_gatt_char("2a19")


@pytest.mark.parametrize(("host", "device"), [(23, 517), (517, 23)])
async def test_either_side_can_keep_the_mtu_small(world: World, host: int, device: int) -> None:
    radio = Radio(world, host_mtu=host)
    probe = Probe(radio, "A0:9E:1A:00:00:02", "Small", max_mtu=device)
    probe.power_on()
    got: list[bytes] = []
    long = bytes(range(150))
    with virtual_bluetooth(radio):
        async with BleakClient(probe.address) as client:
            note = client.services.get_characteristic(NOTE)
            assert note
            assert (client.mtu_size, note.max_write_without_response_size) == (23, 20)
            await client.write_gatt_char(note, long, response=True)
            assert await client.read_gatt_char(note) == long
            with pytest.raises(BleakError, match="do not fit"):
                await client.write_gatt_char(note, long, response=False)
            await client.start_notify(FLOW, lambda _, data: got.append(bytes(data)))
            with pytest.raises(ValueError, match="do not fit"):
                probe.notify(probe.flow, long[:21])
            assert probe.notify(probe.flow, long[:20]) == [True]
            await until(lambda: got)
    assert got == [long[:20]]


async def test_pairing_is_demanded(probe: Probe) -> None:
    probe.peripheral.demand_pairing = True
    async with BleakClient(probe.address) as client:
        for attempt in (
            client.read_gatt_char(SECRET),
            client.write_gatt_char(SECRET, b"new", response=True),
            client.start_notify(SECRET, lambda _, __: None),
        ):
            with pytest.raises(BleakGATTProtocolError) as caught:
                await attempt
            assert caught.value.code == 0x05
        assert await client.read_gatt_char(SERIAL) == b"0815"
        await client.pair()
        assert await client.read_gatt_char(SECRET) == b"secret"
        await client.start_notify(SECRET, lambda _, __: None)
        await client.write_gatt_char(SECRET, b"new", response=True)
        await client.pair()
    async with BleakClient(probe.address) as client:
        assert await client.read_gatt_char(SECRET) == b"new", "the bond lasts"
        await client.unpair()
        assert not client.is_connected
    async with BleakClient(probe.address) as client:
        with pytest.raises(BleakGATTProtocolError):
            await client.read_gatt_char(SECRET)


# What a plain BleakScanner hears on the virtual radio.
HEART_RATE = "0000180d-0000-1000-8000-00805f9b34fb"


async def test_the_name_comes_with_the_scan_response(probe: Probe) -> None:
    names: list[str | None] = []
    async with BleakScanner(lambda _, data: names.append(data.local_name)):
        await until(lambda: len(names) >= 4)
    assert names[0] is None
    assert set(names[1:]) == {"Probe 1"}


async def test_a_scan_for_a_service_hears_only_those_who_have_it(probe: Probe) -> None:
    other = Peripheral(probe.radio, "A0:9E:1A:00:00:02", "Other", service_uuids=["181a"])
    probe.radio.world.await_(other.power_on([]))
    heard: set[str] = set()
    everybody: set[str] = set()
    async with (
        BleakScanner(lambda device, _: heard.add(device.address), [HEART_RATE.upper()]),
        BleakScanner(lambda device, _: everybody.add(device.address)),
    ):
        await until(lambda: everybody == {probe.address, other.address})
        await until(lambda: heard)
    assert heard == {probe.address}


async def test_a_scan_does_not_survive_the_radio(probe: Probe) -> None:
    heard: list[str] = []
    async with BleakScanner(lambda device, _: heard.append(device.address)):
        await until(lambda: heard)
        probe.radio.available = False
        probe.radio.available = True
        probe.radio.world.call(lambda: None)
        await asyncio.sleep(0)
        heard.clear()
        again = await BleakScanner.find_device_by_name("Probe 1", timeout=20)
        assert again is not None
    assert not heard


async def test_bleak_gets_its_own_backends_back(radio: Radio) -> None:
    assert BleakScanner().backend_id == "virtual"
    inner = bleak.backends.scanner.get_platform_scanner_backend_type
    with virtual_bluetooth(radio):
        assert bleak.backends.scanner.get_platform_scanner_backend_type is not inner
    assert bleak.backends.scanner.get_platform_scanner_backend_type is inner


@pytest.mark.parametrize(
    ("name", "data"), [("N" * 30, b""), ("short", bytes(30))], ids=["name", "data"]
)
async def test_what_does_not_fit_into_an_advertisement_is_refused(
    radio: Radio, name: str, data: bytes
) -> None:
    with pytest.raises(ValueError, match="do not fit"):
        peripheral = Peripheral(radio, "A0:9E:1A:00:00:03", name, manufacturer_data={1: data})
        radio.world.await_(peripheral.power_on([]))


# Links that break, hang and come back on the virtual radio, through a plain BleakClient.


async def test_a_local_disconnect_calls_back_before_it_returns(probe: Probe) -> None:
    gone: list[BleakClient] = []
    client = BleakClient(probe.address, gone.append)
    await client.connect()
    await client.disconnect()
    assert gone == [client]
    assert not client.is_connected
    await until(lambda: not probe.peripheral.connected)
    await client.disconnect()


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
