"""How a Bluetooth LE link comes about, and why it may not."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from bleak import BleakClient, BleakScanner
from bleak.exc import BleakDBusError, BleakDeviceNotFoundError, BleakError

from biosensor_common.errors import (
    TransportReason,
)
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.transports import ble
from biosensor_gateway.transports.ble import BleLink
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.polling import until
from tests.rigs.probe import SERIAL, Probe
from tests.rigs.probe_link import DEADLINE_S, choice, refusal, switched_on


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
