"""Bluetooth LE links: found, used, cut and closed, through plain bleak on a virtual radio."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable, Iterator
from contextlib import suppress
from typing import Any

import pytest
from bleak import BleakClient, BleakScanner
from bleak.exc import BleakDBusError, BleakDeviceNotFoundError, BleakError
from pylsl import local_clock

from biosensor_common.errors import (
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportReason,
)
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.world import World
from biosensor_gateway.transports import ble, ble_choice, ble_scanner
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_errors import AttError
from biosensor_gateway.transports.ble_scanner import advertisements, scan
from biosensor_gateway.transports.seen import Advertisement
from tests.rigs.polling import until
from tests.rigs.probe import COMPANY, EVENT, FLOW, NOTE, REFUSAL, SECRET, SERIAL, Probe

DEADLINE_S = 20.0
HEART_RATE = "0000180d-0000-1000-8000-00805f9b34fb"


@pytest.fixture
def radio() -> Iterator[Radio]:
    with World() as world:
        radio = Radio(world)
        with virtual_bluetooth(radio):
            yield radio


@pytest.fixture
def probe(radio: Radio) -> Probe:
    return switched_on(radio, 1)


@pytest.fixture
async def link(probe: Probe) -> AsyncGenerator[BleLink]:
    opened = BleLink(choice("1"))
    await opened.open()
    yield opened
    await opened.close()


@pytest.fixture
def hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give up early what a test wants to be given up."""
    monkeypatch.setattr(ble_choice, "SCAN_S", 0.5)
    monkeypatch.setattr(ble_choice, "RIVALS_S", 0.5)


def switched_on(radio: Radio, number: int, *, rssi_dbm: int = -58) -> Probe:
    probe = Probe(radio, f"A0:9E:1A:00:00:{number:02X}", f"Probe {number}", rssi_dbm=rssi_dbm)
    probe.power_on()
    return probe


def number_of(seen: Advertisement) -> str | None:
    kind, _, number = seen.name.partition(" ")
    return number if kind == "Probe" else None


def choice(device: str = "") -> Choice:
    return Choice(number_of, "Probe", device, "press its button")


async def refusal(attempt: Any) -> GatewayError:
    with pytest.raises(GatewayError) as caught:
        await asyncio.wait_for(attempt, DEADLINE_S)
    return caught.value


async def hang(*_: Any) -> None:
    """Like a call whose service has died: it does not heed its cancellation."""
    with suppress(asyncio.CancelledError):
        await asyncio.Event().wait()
    await asyncio.Event().wait()


async def test_open_returns_what_the_device_advertised(radio: Radio, probe: Probe) -> None:
    link = BleLink(choice("1"))
    seen = await link.open()
    assert (seen.address, seen.name, seen.rssi_dbm) == (probe.address, "Probe 1", -58)
    assert HEART_RATE in seen.service_uuids
    assert seen.manufacturer_data == {COMPANY: b"\x01\x02\x03"}
    await link.close()


async def test_values_are_read_and_written(link: BleLink, probe: Probe) -> None:
    assert await link.read(SERIAL) == b"0815"
    await link.write(NOTE, b"with", response=True)
    await link.write(NOTE, b"without", response=False)
    await until(lambda: probe.notes == [b"with", b"without"])


async def test_requests_at_the_same_time_take_turns(link: BleLink, probe: Probe) -> None:
    notes = [bytes([number]) for number in range(10)]
    async with asyncio.TaskGroup() as tasks:
        for note in notes:
            tasks.create_task(link.write(NOTE, note))
        reading = tasks.create_task(link.read(SERIAL))
    assert sorted(probe.notes) == notes
    assert reading.result() == b"0815"


async def test_characteristics_are_known_even_when_the_link_is_gone(link: BleLink) -> None:
    await link.close()
    assert link.has(FLOW)
    assert link.properties(FLOW) == {"notify", "read"}
    assert not link.has("2a37")
    assert link.properties("2a37") == frozenset()


async def test_short_uuids_mean_the_long_ones(link: BleLink) -> None:
    assert link.has("2A00")
    assert link.has("00002a00-0000-1000-8000-00805F9B34FB")


async def test_a_missing_characteristic_is_unsupported(link: BleLink) -> None:
    error = await refusal(link.read("2a37"))
    assert isinstance(error, ProtocolError)
    assert error.reason is ProtocolReason.UNSUPPORTED


async def test_notifications_and_indications_come_in_order(link: BleLink, probe: Probe) -> None:
    await link.subscribe(FLOW)
    await link.subscribe(EVENT)
    before = local_clock()
    probe.notify(probe.flow, b"1", b"2")
    probe.notify(probe.event, b"3")
    received = [await link.next() for _ in range(3)]
    assert [(each.uuid, each.data) for each in received] == [
        (FLOW, b"1"), (FLOW, b"2"), (EVENT, b"3")
    ]  # fmt: skip
    arrivals = [before, *(each.arrival for each in received), local_clock()]
    assert arrivals == sorted(arrivals)


async def test_nothing_comes_after_unsubscribing(link: BleLink, probe: Probe) -> None:
    await link.subscribe(FLOW)
    await link.unsubscribe(FLOW)
    assert probe.notify(probe.flow, b"1") == [False]


async def test_what_had_arrived_is_taken_before_the_loss(link: BleLink, probe: Probe) -> None:
    await link.subscribe(FLOW)
    probe.notify(probe.flow, b"1", b"2")
    probe.drop()
    assert [(await link.next()).data for _ in range(2)] == [b"1", b"2"]
    for _ in range(2):
        assert (await refusal(link.next())).reason is TransportReason.LOST


async def test_a_loss_wakes_whoever_waits(link: BleLink, probe: Probe) -> None:
    waiting = asyncio.create_task(link.next())
    await asyncio.sleep(0)
    probe.drop()
    assert (await refusal(waiting)).reason is TransportReason.LOST


@pytest.mark.parametrize("ask", ["read", "write", "subscribe"])
async def test_a_loss_ends_a_request_under_way(ask: str, link: BleLink, probe: Probe) -> None:
    probe.set_stalled(True)
    requests: dict[str, Callable[[], Any]] = {
        "read": lambda: link.read(SERIAL),
        "write": lambda: link.write(NOTE, b"1"),
        "subscribe": lambda: link.subscribe(FLOW),
    }
    asking = asyncio.create_task(requests[ask]())
    await asyncio.sleep(0)
    probe.drop()
    assert (await refusal(asking)).reason is TransportReason.LOST
    assert (await refusal(requests[ask]())).reason is TransportReason.LOST


async def test_a_device_that_does_not_answer_is_silent(link: BleLink, probe: Probe) -> None:
    probe.set_stalled(True)
    assert (await refusal(link.read(SERIAL))).reason is TransportReason.SILENT


async def test_a_refusal_carries_its_code(link: BleLink) -> None:
    for request, code in ((link.read(REFUSAL), 0x80), (link.write(REFUSAL, b"\xfd"), 0xFD)):
        error = await refusal(request)
        assert isinstance(error, AttError)
        assert (error.code, error.reason) == (code, ProtocolReason.REFUSED)
    assert await link.read(SERIAL) == b"0815"


@pytest.mark.parametrize("pair_first", [False, True])
async def test_a_device_may_have_to_be_paired(radio: Radio, pair_first: bool) -> None:
    probe = Probe(radio, "A0:9E:1A:00:00:01", "Probe 1")
    probe.peripheral.demand_pairing = True
    probe.power_on()
    link = BleLink(choice("1"), pair_first=pair_first)
    await link.open()
    if not pair_first:
        error = await refusal(link.read(SECRET))
        assert isinstance(error, AttError)
        assert error.code == 0x05
        await link.pair()
    assert await link.read(SECRET) == b"secret"
    await link.close()


async def test_a_system_that_cannot_pair_by_command_pairs_by_itself(
    link: BleLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def unknown(*_: Any) -> None:
        raise NotImplementedError

    monkeypatch.setattr(BleakClient, "pair", unknown)
    await link.pair()


async def test_a_failed_pairing_is_denied(link: BleLink, monkeypatch: pytest.MonkeyPatch) -> None:
    async def fails(*_: Any) -> None:
        raise BleakError("Failure trying to pair with device!")

    monkeypatch.setattr(BleakClient, "pair", fails)
    assert (await refusal(link.pair())).reason is TransportReason.DENIED


async def test_closing_sets_the_device_free(link: BleLink, probe: Probe) -> None:
    await link.close()
    await until(lambda: not probe.peripheral.connected)
    assert (await refusal(link.read(SERIAL))).reason is TransportReason.LOST
    assert (await refusal(link.next())).reason is TransportReason.LOST
    await link.close()


async def test_a_link_that_was_never_opened_can_be_closed(radio: Radio) -> None:
    await BleLink(choice()).close()


@pytest.mark.parametrize("trouble", ["hangs", "raises"])
async def test_closing_ends_whatever_the_system_does(
    trouble: str, link: BleLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fails(*_: Any) -> None:
        if trouble == "hangs":
            await asyncio.Event().wait()
        raise EOFError

    monkeypatch.setattr(BleakClient, "disconnect", fails)
    await asyncio.wait_for(link.close(), DEADLINE_S)


async def test_a_dead_bluetooth_service_ends_requests(
    link: BleLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fails(*_: Any, **__: Any) -> bytearray:
        raise BleakDBusError("org.freedesktop.DBus.Error.ServiceUnknown", ["no such name"])

    monkeypatch.setattr(BleakClient, "read_gatt_char", fails)
    error = await refusal(link.read(SERIAL))
    assert error.reason is TransportReason.LOST
    assert "Bluetooth system" in str(error)


async def test_a_call_that_cancels_itself_is_a_loss(
    link: BleLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def cancelled(*_: Any, **__: Any) -> bytearray:
        raise asyncio.CancelledError

    monkeypatch.setattr(BleakClient, "read_gatt_char", cancelled)
    assert (await refusal(link.read(SERIAL))).reason is TransportReason.LOST


async def test_stopping_while_connecting_leaves_the_device_free(
    probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    entered = asyncio.Event()
    connect = BleakClient.connect

    async def slowly(self: BleakClient, **kwargs: Any) -> None:
        await connect(self, **kwargs)
        entered.set()
        await asyncio.sleep(3600)

    monkeypatch.setattr(BleakClient, "connect", slowly)
    link = BleLink(choice("1"))
    opening = asyncio.create_task(link.open())
    await asyncio.wait_for(entered.wait(), DEADLINE_S)
    opening.cancel()
    with pytest.raises(asyncio.CancelledError):
        await opening
    await link.close()
    await until(lambda: not probe.peripheral.connected)


@pytest.mark.usefixtures("hurry")
async def test_an_absent_device_is_absent_with_advice(probe: Probe) -> None:
    error = await refusal(BleLink(choice("2")).open())
    assert error.reason is TransportReason.ABSENT
    assert str(error) == "Probe 2 is not in range; press its button"


async def test_a_radio_that_is_off_is_unavailable(radio: Radio) -> None:
    radio.available = False
    assert (await refusal(BleLink(choice()).open())).reason is TransportReason.UNAVAILABLE


@pytest.mark.parametrize(
    ("cause", "reason"),
    [
        (OSError(22, "class not registered", None, -2147221164), TransportReason.UNAVAILABLE),
        (FileNotFoundError("no bus"), TransportReason.UNAVAILABLE),
        (PermissionError("not for you"), TransportReason.DENIED),
        (BleakDBusError("org.bluez.Error.InProgress", ["busy"]), TransportReason.BUSY),
        (BleakError("Failed to start scanner"), TransportReason.UNAVAILABLE),
    ],
)
async def test_a_scan_that_does_not_start_tells_why(
    cause: Exception, reason: TransportReason, radio: Radio, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fails(_: BleakScanner) -> None:
        raise cause

    with monkeypatch.context() as patch:
        patch.setattr(BleakScanner, "start", fails)
        assert (await refusal(BleLink(choice("1")).open())).reason is reason
    switched_on(radio, 1)
    link = BleLink(choice("1"))
    await link.open()
    await link.close()


@pytest.mark.parametrize(
    ("cause", "reason"),
    [
        (BleakError("le-connection-abort-by-local"), TransportReason.ABSENT),
        (OSError("the semaphore timeout period has expired"), TransportReason.ABSENT),
        (TimeoutError(), TransportReason.ABSENT),
        (BleakDeviceNotFoundError("1"), TransportReason.ABSENT),
        (BleakDBusError("org.bluez.Error.NotReady", ["off"]), TransportReason.UNAVAILABLE),
        (BleakDBusError("org.bluez.Error.AuthenticationFailed", []), TransportReason.DENIED),
    ],
)
async def test_a_connection_that_fails_tells_why(
    cause: Exception, reason: TransportReason, probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fails(*_: Any, **__: Any) -> None:
        raise cause

    monkeypatch.setattr(BleakClient, "connect", fails)
    assert (await refusal(BleLink(choice("1")).open())).reason is reason


async def test_a_device_that_the_system_forgot_is_looked_for_again(
    probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    connect, attempts = BleakClient.connect, list[BleakClient]()

    async def forgetful(self: BleakClient, **kwargs: Any) -> None:
        attempts.append(self)
        if len(attempts) == 1:
            raise BleakDeviceNotFoundError(self.address)
        await connect(self, **kwargs)

    monkeypatch.setattr(BleakClient, "connect", forgetful)
    link = BleLink(choice("1"))
    await link.open()
    assert len(attempts) == 2
    await link.close()


async def test_a_callback_of_an_attempt_that_is_repeated_is_no_loss(
    probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Repeating(BleakClient):
        """BlueZ calls back when its first try is aborted, and bleak tries once more."""

        def __init__(self, device: Any, disconnected_callback: Any, **options: Any) -> None:
            super().__init__(device, disconnected_callback, **options)
            self._call_back = disconnected_callback

        async def connect(self, **kwargs: Any) -> None:
            self._call_back(self)
            await super().connect(**kwargs)

    monkeypatch.setattr(ble, "BleakClient", Repeating)
    link = BleLink(choice("1"))
    await link.open()
    assert await link.read(SERIAL) == b"0815"
    await link.close()


async def test_a_link_that_breaks_at_once_is_absent(
    probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    connect = BleakClient.connect

    async def broken(self: BleakClient, **kwargs: Any) -> None:
        await connect(self, **kwargs)
        probe.drop()
        await until(lambda: not self.is_connected)

    monkeypatch.setattr(BleakClient, "connect", broken)
    assert (await refusal(BleLink(choice("1")).open())).reason is TransportReason.ABSENT


@pytest.mark.parametrize("device", ["2", "probe 2", "a0-9e-1a-00-00-02", "A0:9E:1A:00:00:02"])
async def test_a_device_is_chosen_by_id_name_or_address(
    device: str, radio: Radio, probe: Probe
) -> None:
    other = switched_on(radio, 2)
    link = BleLink(choice(device))
    assert (await link.open()).address == other.address
    await link.close()


@pytest.mark.usefixtures("hurry")
async def test_several_devices_are_refused_by_name(radio: Radio, probe: Probe) -> None:
    switched_on(radio, 2)
    error = await refusal(BleLink(choice()).open())
    assert error.reason is ProtocolReason.REFUSED
    assert "(1, 2)" in str(error)
    assert "`device`" in str(error)


@pytest.mark.usefixtures("hurry")
async def test_the_only_device_is_kept_to(radio: Radio, probe: Probe) -> None:
    chosen = choice()
    first = BleLink(chosen)
    assert (await first.open()).address == probe.address
    switched_on(radio, 2)
    probe.drop()
    await first.close()
    error = await refusal(BleLink(chosen).open())
    assert error.reason is TransportReason.ABSENT
    assert "Probe 1" in str(error)
    probe.restore()
    again = BleLink(chosen)
    assert (await again.open()).address == probe.address
    await again.close()


async def test_one_scan_serves_everybody(
    radio: Radio, probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    scanning, most = list[BleakScanner](), list[int]()
    start, stop = BleakScanner.start, BleakScanner.stop

    async def begin(self: BleakScanner) -> None:
        scanning.append(self)
        most.append(len(scanning))
        await start(self)

    async def end(self: BleakScanner) -> None:
        scanning.remove(self)
        await stop(self)

    monkeypatch.setattr(BleakScanner, "start", begin)
    monkeypatch.setattr(BleakScanner, "stop", end)
    switched_on(radio, 2)
    links = [BleLink(choice("1")), BleLink(choice("2"))]
    seen = await asyncio.gather(*(link.open() for link in links))
    assert [each.name for each in seen] == ["Probe 1", "Probe 2"]
    await until(lambda: not scanning)
    assert max(most) == 1
    for link in links:
        await link.close()


async def test_connections_are_made_one_at_a_time(
    radio: Radio, probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    connecting, most = set[BleakClient](), list[int]()
    connect = BleakClient.connect

    async def noted(self: BleakClient, **kwargs: Any) -> None:
        connecting.add(self)
        most.append(len(connecting))
        await connect(self, **kwargs)
        connecting.remove(self)

    monkeypatch.setattr(BleakClient, "connect", noted)
    switched_on(radio, 2)
    links = [BleLink(choice("1")), BleLink(choice("2"))]
    await asyncio.gather(*(link.open() for link in links))
    assert most == [1, 1]
    for link in links:
        await link.close()


async def test_a_scan_lists_the_strongest_first(radio: Radio, probe: Probe) -> None:
    switched_on(radio, 2, rssi_dbm=-40)
    switched_on(radio, 3, rssi_dbm=-80)
    found = await scan(1.0)
    assert [(each.name, each.rssi_dbm) for each in found] == [
        ("Probe 2", -40), ("Probe 1", -58), ("Probe 3", -80)
    ]  # fmt: skip


async def test_a_late_listener_hears_what_was_heard_just_now(radio: Radio, probe: Probe) -> None:
    async with advertisements() as early:
        while not (await anext(early)).name:
            pass
        radio.world.call(lambda: probe.peripheral.set_advertising(False))
        async with advertisements() as late:
            seen = await asyncio.wait_for(anext(late), DEADLINE_S)
    assert seen.address == probe.address


async def test_a_scan_that_hears_nothing_any_more_is_started_anew(
    radio: Radio, probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    starts, start = list[BleakScanner](), BleakScanner.start

    async def noted(self: BleakScanner) -> None:
        starts.append(self)
        await start(self)

    monkeypatch.setattr(BleakScanner, "start", noted)
    async with advertisements() as early:
        assert (await anext(early)).address == probe.address
        monkeypatch.setattr(ble_scanner, "SILENT_S", 0.0)
        async with advertisements() as late:
            assert (await asyncio.wait_for(anext(late), DEADLINE_S)).address == probe.address
            assert (await asyncio.wait_for(anext(early), DEADLINE_S)).address == probe.address
    assert len(starts) == 2


async def test_a_scan_that_hangs_up_does_not_hold_its_listener(
    radio: Radio, probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(BleakScanner, "stop", hang)
    link = BleLink(choice("1"))
    await asyncio.wait_for(link.open(), DEADLINE_S)
    await link.close()
