"""A Bluetooth LE link: how it comes about, requests, notifications, losses, pairing."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import pytest
from bleak import BleakClient, BleakScanner
from bleak.exc import BleakDBusError, BleakDeviceNotFoundError, BleakError
from pydantic import TypeAdapter, ValidationError

from biosensor_common.errors import (
    GatewayError,
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports import ble, ble_scanner
from biosensor_gateway.transports import bluez as bluez_api
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_errors import (
    EARLY_DROP_S,
    AttError,
    Pairing,
    PairMode,
    PairSetting,
)
from biosensor_gateway.transports.ble_scanner import START_LIMIT_S
from biosensor_gateway.transports.bluez import KnownDevice
from biosensor_gateway.transports.nearby import Advertisement
from tests.rigs.bluetooth import ON_BLUEZ, ON_BUMBLE, SEAM_ON_BLUEZ
from tests.rigs.polling import until
from tests.rigs.probe import (
    COMPANY,
    DEADLINE_S,
    EVENT,
    FLOW,
    NOTE,
    REFUSAL,
    SECRET,
    SERIAL,
    Probe,
    choice,
    refusal,
    switched_on,
)

if TYPE_CHECKING:
    from tests.rigs.bluez import FakeBluez

# A Bluetooth LE link in use: requests, notifications, losses, pairing, closing.

HEART_RATE = "0000180d-0000-1000-8000-00805f9b34fb"


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
    # BlueZ keeps the Generic Access service, which has 0x2A00, to itself.
    assert link.has("2A05")
    assert link.has("00002a05-0000-1000-8000-00805F9B34FB")


async def test_a_missing_characteristic_is_unsupported(link: BleLink) -> None:
    error = await refusal(link.read("2a37"))
    assert isinstance(error, ProtocolError)
    assert error.reason is ProtocolReason.UNSUPPORTED


async def test_notifications_and_indications_come_in_order(link: BleLink, probe: Probe) -> None:
    await link.subscribe(FLOW)
    await link.subscribe(EVENT)
    before = LSL_CLOCK()
    probe.notify(probe.flow, b"1", b"2")
    probe.notify(probe.event, b"3")
    received = [await link.next() for _ in range(3)]
    assert [(each.uuid, each.data) for each in received] == [
        (FLOW, b"1"), (FLOW, b"2"), (EVENT, b"3")
    ]  # fmt: skip
    arrivals = [before, *(each.arrival for each in received), LSL_CLOCK()]
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


async def test_a_device_that_does_not_answer_is_silent(
    link: BleLink, probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert ble.REQUEST_LIMIT_S == 5.0
    monkeypatch.setattr(ble, "REQUEST_LIMIT_S", 0.3)
    probe.set_stalled(True)
    assert (await refusal(link.read(SERIAL))).reason is TransportReason.SILENT


async def test_a_refusal_carries_its_code(link: BleLink) -> None:
    for request, code in ((link.read(REFUSAL), 0x80), (link.write(REFUSAL, b"\xfd"), 0xFD)):
        error = await refusal(request)
        assert isinstance(error, AttError)
        assert (error.code, error.reason) == (code, ProtocolReason.REFUSED)
    assert await link.read(SERIAL) == b"0815"


@pytest.mark.parametrize("pair_first", [False, True])
async def test_a_device_may_have_to_be_paired(rig: str, radio: Radio, pair_first: bool) -> None:
    probe = Probe(radio, "A0:9E:1A:00:00:01", "Probe 1")
    probe.peripheral.demand_pairing = True
    probe.power_on()
    link = BleLink(choice("1"), pairing=Pairing("yes" if pair_first else "auto"))
    await link.open()
    if not pair_first:
        error = await refusal(link.read(SECRET))
        assert isinstance(error, AttError)
        # BlueZ swallows the true one, and answers for itself.
        assert error.code == {"bumble": 0x05, "bluez": 0x0E}[rig]
        await link.pair()
    assert await link.read(SECRET) == b"secret"
    await link.close()


@ON_BUMBLE
async def test_a_system_that_cannot_pair_by_command_pairs_by_itself(
    link: BleLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def unknown(*_: Any) -> None:
        raise NotImplementedError

    monkeypatch.setattr(BleakClient, "pair", unknown)
    await link.pair()


@ON_BUMBLE
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


@ON_BUMBLE
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


@ON_BUMBLE
async def test_a_dead_bluetooth_service_ends_requests(
    link: BleLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fails(*_: Any, **__: Any) -> bytearray:
        raise BleakDBusError("org.freedesktop.DBus.Error.ServiceUnknown", ["no such name"])

    monkeypatch.setattr(BleakClient, "read_gatt_char", fails)
    error = await refusal(link.read(SERIAL))
    assert error.reason is TransportReason.LOST
    assert "Bluetooth system" in str(error)


@ON_BUMBLE
async def test_a_call_that_cancels_itself_is_a_loss(
    link: BleLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def cancelled(*_: Any, **__: Any) -> bytearray:
        raise asyncio.CancelledError

    monkeypatch.setattr(BleakClient, "read_gatt_char", cancelled)
    assert (await refusal(link.read(SERIAL))).reason is TransportReason.LOST


# How a Bluetooth LE link comes about, and why it may not.
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


async def test_a_radio_that_is_off_is_unavailable(radio: Radio) -> None:
    radio.available = False
    assert (await refusal(BleLink(choice()).open())).reason is TransportReason.UNAVAILABLE


@ON_BUMBLE
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


@ON_BUMBLE
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


@ON_BUMBLE
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


@ON_BUMBLE
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


# The system's Bluetooth answers too late: what was given up is taken up again, or undone.


class _Session:
    """BlueZ's rule for scans: one of each program, whether it has been told so or not."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, answer_s: float) -> None:
        self.runs = False
        start, stop, answered = BleakScanner.start, BleakScanner.stop, set[BleakScanner]()

        async def begin(scanner: BleakScanner) -> None:
            if self.runs:
                raise BleakDBusError("org.bluez.Error.InProgress", ["in progress"])
            self.runs = True
            await asyncio.sleep(answer_s)
            await start(scanner)
            answered.add(scanner)

        async def end(scanner: BleakScanner) -> None:
            # bleak cannot stop what it was not told of.
            if scanner in answered:
                self.runs = False
                await stop(scanner)

        monkeypatch.setattr(BleakScanner, "start", begin)
        monkeypatch.setattr(BleakScanner, "stop", end)


@ON_BUMBLE
async def test_a_scan_that_begins_too_late_finds_the_device(
    probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = _Session(monkeypatch, 1.5 * START_LIMIT_S)
    link = BleLink(choice("1"))
    error = await refusal(link.open())
    assert error.reason is TransportReason.UNAVAILABLE
    assert "does not start to search within 10 s" in str(error)
    assert (await link.open()).address == probe.address
    await link.close()
    await until(lambda: not session.runs)


@ON_BUMBLE
async def test_a_scan_that_begins_when_nobody_waits_any_more_is_ended(
    probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    del probe
    session = _Session(monkeypatch, 1.5 * START_LIMIT_S)
    await refusal(BleLink(choice("1")).open())
    assert session.runs
    await asyncio.sleep(START_LIMIT_S)
    assert not session.runs


@ON_BUMBLE
async def test_a_request_that_is_given_up_keeps_its_turn(
    link: BleLink, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, under_way, most = BleakClient.read_gatt_char, list[int](), list[int]()

    async def slowly(client: BleakClient, which: Any, **options: Any) -> bytearray:
        under_way.append(1)
        most.append(len(under_way))
        # As the system does: it does not take a call back.
        await asyncio.shield(asyncio.ensure_future(asyncio.sleep(1.5 * ble.REQUEST_LIMIT_S)))
        under_way.pop()
        return await read(client, which, **options)

    monkeypatch.setattr(BleakClient, "read_gatt_char", slowly)
    error = await refusal(link.read(SERIAL))
    assert error.reason is TransportReason.SILENT
    monkeypatch.setattr(BleakClient, "read_gatt_char", read)
    assert await link.read(SERIAL) == b"0815"
    assert (most, under_way) == ([1], [])


@ON_BUMBLE
async def test_a_request_that_was_not_made_in_time_is_never_made(
    link: BleLink, probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    read, may_end = BleakClient.read_gatt_char, asyncio.Event()

    async def slowly(client: BleakClient, which: Any, **options: Any) -> bytearray:
        await may_end.wait()
        return await read(client, which, **options)

    monkeypatch.setattr(BleakClient, "read_gatt_char", slowly)
    await refusal(link.read(SERIAL))
    await refusal(link.write(NOTE, b"too late"))
    may_end.set()
    assert await link.read(SERIAL) == b"0815"
    await link.write(NOTE, b"in time")
    assert probe.notes == [b"in time"]


@ON_BUMBLE
async def test_a_connection_that_came_after_all_is_freed(
    probe: Probe, monkeypatch: pytest.MonkeyPatch
) -> None:
    held, freed = list[KnownDevice](), list[str]()

    async def known() -> list[KnownDevice]:
        return held

    async def disconnect(path: str) -> None:
        freed.append(path)

    async def refuse(client: BleakClient, **_: Any) -> None:
        raise TimeoutError

    monkeypatch.setattr(bluez_api, "known_devices", known)
    monkeypatch.setattr(bluez_api, "disconnect", disconnect)
    chosen, connect = choice("1"), BleakClient.connect
    link = BleLink(chosen)
    monkeypatch.setattr(BleakClient, "connect", refuse)
    for _ in range(2):
        await refusal(link.open())
    held.append(KnownDevice("/1", Advertisement(probe.address, "Probe 1"), True, False, False))
    monkeypatch.setattr(BleakClient, "connect", connect)
    await link.open()
    assert freed == ["/1"]
    # From now on, whatever is connected may be somebody's.
    await link.close()
    again = BleLink(chosen)
    await again.open()
    await again.close()
    assert freed == ["/1"]


@pytest.fixture
def short_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ble_scanner, "START_LIMIT_S", 0.5)
    monkeypatch.setattr(ble_scanner, "STOP_LIMIT_S", 0.2)
    monkeypatch.setattr(ble, "CONNECT_LIMIT_S", 1.5)
    monkeypatch.setattr(ble, "REQUEST_LIMIT_S", 0.7)


async def _works(chosen: Choice) -> bool:
    link = BleLink(chosen)
    with suppress(GatewayError):
        try:
            await link.open()
            await link.subscribe(FLOW)
            await link.write(NOTE, b"1")
            return await link.read(SERIAL) == b"0815"
        finally:
            await link.close()
    return False


async def _recovers_from(late: str, bluez: FakeBluez) -> None:
    bluez.late[late] = 3.0
    chosen, attempts = choice("1"), 1
    async with asyncio.timeout(DEADLINE_S):
        # Twice: what is late may be the end of the first one.
        for _ in range(2):
            while not await _works(chosen):
                attempts += 1
        await until(lambda: not (bluez.scanning or bluez.connected))
    assert not bluez.late
    # Whoever gives up is no obstacle to the next one.
    assert attempts < 8


@SEAM_ON_BLUEZ
@pytest.mark.usefixtures("short_limits", "probe")
async def test_bluez_begins_a_scan_too_late(bluez: FakeBluez) -> None:
    await _recovers_from("StartDiscovery", bluez)


@ON_BLUEZ
@pytest.mark.usefixtures("short_limits", "probe")
@pytest.mark.parametrize(
    "late",
    [
        "SetDiscoveryFilter",
        "StopDiscovery",
        "Connect",
        "Disconnect",
        "StartNotify",
        "ReadValue",
        "WriteValue",
        "GetManagedObjects",
    ],
)
async def test_bluez_answers_anything_too_late(bluez: FakeBluez, late: str) -> None:
    await _recovers_from(late, bluez)


# When a device is paired and when it is forgotten: Windows' part of it without Windows.

SILENT = TransportError(TransportReason.SILENT, "no answer")
LOST = TransportError(TransportReason.LOST, "cut")
ADDRESS = "A0:9E:1A:00:00:01"
PLATFORMS = ("win32", "linux", "darwin")


@pytest.mark.parametrize(
    ("value", "mode"),
    [("auto", "auto"), ("yes", "yes"), ("no", "no"), (True, "yes"), (False, "auto")],
)
def test_the_setting_is_a_mode_or_a_switch(value: object, mode: PairMode) -> None:
    assert TypeAdapter[PairMode](PairSetting).validate_python(value) == mode


@pytest.mark.parametrize("value", ["", "true", 1, None])
def test_nothing_else_is_one(value: object) -> None:
    with pytest.raises(ValidationError):
        TypeAdapter[PairMode](PairSetting).validate_python(value)


@pytest.mark.parametrize("platform", PLATFORMS)
@pytest.mark.parametrize(
    ("error", "is_unanswered", "helps"),
    [
        (AttError(0x05, "strap"), True, True),
        (AttError(0x05, "strap"), False, True),
        (AttError(0x0F, "strap"), True, True),
        (AttError(0x0E, "strap"), True, True),
        (AttError(0x0E, "strap"), False, False),
        (AttError(0x80, "strap"), True, False),
        (SILENT, True, True),
        (SILENT, False, False),
        (LOST, True, False),
    ],
)
def test_what_pairing_helps_against(
    platform: str, error: GatewayError, *, is_unanswered: bool, helps: bool
) -> None:
    assert Pairing("auto", platform).helps(error, is_unanswered=is_unanswered) is helps
    assert not Pairing("no", platform).helps(error, is_unanswered=is_unanswered)


@pytest.mark.parametrize("platform", PLATFORMS)
def test_who_wants_it_pairs_before_each_connection(platform: str) -> None:
    assert Pairing("yes", platform).comes_first
    assert not Pairing("auto", platform).comes_first
    assert not Pairing("no", platform).comes_first


def test_windows_pairs_first_once_the_device_has_demanded_it() -> None:
    windows, linux = Pairing(platform="win32"), Pairing(platform="linux")
    windows.note_demand()
    linux.note_demand()
    assert (windows.comes_first, linux.comes_first) == (True, False)


@pytest.mark.parametrize("after_s", [0.0, 0.2, EARLY_DROP_S - 0.01])
def test_windows_pairs_first_after_an_early_drop(after_s: float) -> None:
    pairing = Pairing(platform="win32")
    pairing.note_drop(after_s)
    assert pairing.comes_first


@pytest.mark.parametrize(
    ("mode", "platform", "after_s"),
    [("auto", "win32", EARLY_DROP_S), ("no", "win32", 0.0), ("auto", "linux", 0.0)],
)
def test_no_other_drop_means_anything(mode: PairMode, platform: str, after_s: float) -> None:
    pairing = Pairing(mode, platform)
    pairing.note_drop(after_s)
    assert not pairing.comes_first


def test_paired_and_unpaired_are_tried_in_turns_while_neither_works() -> None:
    pairing = Pairing(platform="win32")
    tried: list[bool] = []
    for _ in range(4):
        tried.append(pairing.comes_first)
        pairing.note_drop(0.0)
    assert tried == [False, True, False, True]


def test_what_is_paired_stays_so_through_a_drop() -> None:
    pairing = Pairing(platform="win32")
    pairing.note_drop(0.0)
    pairing.note_paired()
    for after_s in (0.1, 600.0):
        pairing.note_drop(after_s)
        assert pairing.comes_first


@pytest.mark.parametrize("platform", PLATFORMS)
def test_only_windows_forgets_it_at_the_end_and_only_what_it_did_for_us(platform: str) -> None:
    pairing = Pairing(platform=platform)
    assert not pairing.ends_with_connection
    pairing.note_paired()
    assert pairing.ends_with_connection is (platform == "win32")
    pairing.note_unpaired()
    assert not pairing.ends_with_connection
    assert pairing.uses_known_services is (platform != "win32")


class Calls:
    """Notes what is asked of bleak, in order; the virtual system does it all the same."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.made: list[str] = []
        self.options: list[dict[str, Any]] = []
        for name in ("pair", "unpair", "disconnect"):
            monkeypatch.setattr(BleakClient, name, self._noting(name, getattr(BleakClient, name)))
        original = BleakClient.__init__

        def make(client: BleakClient, *args: Any, **options: Any) -> None:
            self.options.append(options)
            original(client, *args, **options)

        monkeypatch.setattr(BleakClient, "__init__", make)

    def _noting(self, name: str, original: Callable[..., Any]) -> Callable[..., Any]:
        async def call(client: BleakClient) -> None:
            self.made.append(name)
            await original(client)

        return call


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Calls:
    return Calls(monkeypatch)


@pytest.fixture
def probe(radio: Radio) -> Probe:
    probe = Probe(radio, ADDRESS, "Probe 1")
    probe.peripheral.demand_pairing = True
    probe.power_on()
    return probe


def link_of(pairing: Pairing) -> BleLink:
    return BleLink(Choice(lambda seen: seen.address, "probe", ADDRESS), pairing=pairing)


@ON_BUMBLE
async def test_on_windows_the_pairing_ends_before_the_connection(
    probe: Probe, calls: Calls
) -> None:
    link = link_of(Pairing(platform="win32"))
    await link.open()
    await link.pair()
    assert await link.read(SECRET) == b"secret"
    await link.close()
    await until(lambda: not probe.peripheral.connected)
    assert calls.made == ["pair", "unpair", "disconnect"]
    assert calls.options[0]["winrt"] == {"use_cached_services": False}


@ON_BUMBLE
async def test_elsewhere_it_stays(probe: Probe, calls: Calls) -> None:
    link = link_of(Pairing(platform="linux"))
    await link.open()
    await link.pair()
    await link.close()
    await until(lambda: not probe.peripheral.connected)
    assert calls.made == ["pair", "disconnect"]
    assert calls.options[0]["winrt"] == {}


@ON_BUMBLE
async def test_a_link_that_drops_at_once_is_paired_before_the_next_one(
    probe: Probe, calls: Calls
) -> None:
    pairing = Pairing(platform="win32")
    link = link_of(pairing)
    await link.open()
    probe.drop()
    with pytest.raises(TransportError):
        await link.next()
    await link.close()
    assert calls.options[0]["pair"] is False
    probe.restore()
    again = link_of(pairing)
    await again.open()
    assert await again.read(SECRET) == b"secret"
    await again.close()
    assert calls.options[-1]["pair"] is True
    assert calls.made[-2:] == ["unpair", "disconnect"]


@ON_BUMBLE
async def test_who_cannot_unpair_disconnects_all_the_same(
    probe: Probe, calls: Calls, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def fails(_: BleakClient) -> None:
        raise BleakError("Failed to unpair device")

    monkeypatch.setattr(BleakClient, "unpair", fails)
    link = link_of(Pairing(platform="win32"))
    await link.open()
    await link.pair()
    await link.close()
    await until(lambda: not probe.peripheral.connected)
    assert calls.made == ["pair", "disconnect"]
