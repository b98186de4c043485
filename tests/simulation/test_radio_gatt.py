"""GATT through a plain BleakClient on the virtual radio."""

from __future__ import annotations

import asyncio

import pytest
from bleak import BleakClient
from bleak.exc import BleakCharacteristicNotFoundError, BleakError, BleakGATTProtocolError

from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.world import World
from tests.rigs.polling import until
from tests.rigs.probe import EVENT, FLOW, NOTE, REFUSAL, SECRET, SERIAL, SERVICE, Probe

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


async def test_services_can_be_chosen(probe: Probe) -> None:
    async with BleakClient(probe.address, services=[SERVICE]) as client:
        assert [service.uuid for service in client.services] == [SERVICE]


async def test_reading_and_writing(probe: Probe) -> None:
    async with BleakClient(probe.address) as client:
        assert await client.read_gatt_char(SERIAL) == b"0815"
        await client.write_gatt_char(NOTE, b"one", response=True)
        await client.write_gatt_char(NOTE, b"two", response=False)
        assert await client.read_gatt_char(NOTE) == b"two"
    assert probe.notes == [b"one", b"two"]


async def test_many_writes_keep_their_order(probe: Probe) -> None:
    sent = [count.to_bytes(2, "big") for count in range(200)]
    async with BleakClient(probe.address) as client:
        for data in sent:
            await client.write_gatt_char(NOTE, data, response=False)
        await until(lambda: len(probe.notes) == len(sent))
    assert probe.notes == sent


async def test_two_thousand_notifications_arrive_in_order(probe: Probe) -> None:
    sent = [count.to_bytes(2, "big") * 100 for count in range(2000)]
    got: list[bytes] = []
    async with BleakClient(probe.address) as client:
        await client.start_notify(FLOW, lambda _, data: got.append(bytes(data)))
        assert all(probe.notify(probe.flow, *sent))
        await until(lambda: len(got) >= len(sent))
    assert got == sent


async def test_subscribing_and_unsubscribing(probe: Probe) -> None:
    got: list[bytes] = []
    async with BleakClient(probe.address) as client:
        assert probe.notify(probe.flow, b"early") == [False]
        await client.start_notify(FLOW, lambda _, data: got.append(bytes(data)))
        assert probe.notify(probe.flow, b"heard") == [True]
        await client.stop_notify(FLOW)
        assert probe.notify(probe.flow, b"late") == [False]
        assert await client.read_gatt_char(FLOW) == b"still"
    assert got == [b"heard"]
    assert not probe.peripheral.subscribed(probe.flow)


async def test_subscribing_again_replaces_the_callback(probe: Probe) -> None:
    first: list[bytes] = []
    second: list[bytes] = []
    async with BleakClient(probe.address) as client:
        await client.start_notify(FLOW, lambda _, data: first.append(bytes(data)))
        await client.start_notify(FLOW, lambda _, data: second.append(bytes(data)))
        assert probe.notify(probe.flow, b"one") == [True]
        await until(lambda: second)
    assert (first, second) == ([], [b"one"])


async def test_an_indication_returns_when_it_is_confirmed(probe: Probe) -> None:
    got: list[bytes] = []
    async with BleakClient(probe.address) as client:
        await client.start_notify(EVENT, lambda _, data: got.append(bytes(data)))
        assert probe.notify(probe.event, b"one", b"two") == [True, True]
        await until(lambda: len(got) == 2)
    assert got == [b"one", b"two"]


@pytest.mark.parametrize("code", [0x05, 0x0E, 0x0F, 0x80, 0xFD])
async def test_att_errors_arrive_with_their_codes(probe: Probe, code: int) -> None:
    async with BleakClient(probe.address) as client:
        with pytest.raises(BleakGATTProtocolError) as caught:
            await client.write_gatt_char(REFUSAL, bytes([code]), response=True)
        assert caught.value.code == code
        with pytest.raises(BleakGATTProtocolError) as caught:
            await client.read_gatt_char(REFUSAL)
        assert caught.value.code == 0x80


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


async def test_the_mtu_is_large(probe: Probe) -> None:
    async with BleakClient(probe.address) as client:
        assert client.mtu_size >= 247
        assert probe.peripheral.host_mtu == client.mtu_size
    await until(lambda: probe.peripheral.host_mtu == 23)


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


async def test_two_devices_at_once(probe: Probe) -> None:
    other = Probe(probe.radio, "A0:9E:1A:00:00:02", "Probe 2")
    other.power_on()
    sent = {
        each: [each.peripheral.name.encode() + bytes([n]) for n in range(100)]
        for each in (probe, other)
    }
    got: dict[Probe, list[bytes]] = {probe: [], other: []}
    clients = {each: BleakClient(each.address) for each in got}
    await asyncio.gather(*(client.connect() for client in clients.values()))
    for each, client in clients.items():
        values = got[each]
        await client.start_notify(FLOW, lambda _, data, values=values: values.append(bytes(data)))
    for first, second in zip(sent[probe], sent[other], strict=True):
        probe.notify(probe.flow, first)
        other.notify(other.flow, second)
    await until(lambda: all(len(values) == 100 for values in got.values()))
    assert got == sent
    await clients[probe].disconnect()
    assert clients[other].is_connected
    assert await clients[other].read_gatt_char(SERIAL) == b"0815"
    await clients[other].disconnect()


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


async def test_pairing_while_connecting(probe: Probe) -> None:
    probe.peripheral.demand_pairing = True
    async with BleakClient(probe.address, pair=True) as client:
        assert await client.read_gatt_char(SECRET) == b"secret"


async def test_pairing_is_not_demanded_unless_asked_for(probe: Probe) -> None:
    async with BleakClient(probe.address) as client:
        assert await client.read_gatt_char(SECRET) == b"secret"
