"""The system's Bluetooth answers too late: what was given up is taken up again, or undone."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import pytest
from bleak import BleakClient, BleakScanner
from bleak.exc import BleakDBusError

from biosensor_common.errors import GatewayError, TransportReason
from biosensor_gateway.transports import ble, ble_scanner
from biosensor_gateway.transports import bluez as bluez_api
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.ble_scanner import START_LIMIT_S
from biosensor_gateway.transports.bluez import KnownDevice
from biosensor_gateway.transports.nearby import Advertisement
from tests.rigs.bluetooth import ON_BLUEZ, ON_BUMBLE, SEAM_ON_BLUEZ
from tests.rigs.polling import until
from tests.rigs.probe import DEADLINE_S, FLOW, NOTE, SERIAL, Probe, choice, refusal

if TYPE_CHECKING:
    from tests.rigs.bluez import FakeBluez


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
    assert "does not begin to search within 10 s" in str(error)
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
