"""What BlueZ does to Bluetooth LE links, and what it keeps connected."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import AsyncGenerator, Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import pytest
from bleak import BleakClient
from structlog.testing import capture_logs

from biosensor_common.errors import TransportReason
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.bluez import known_devices
from tests.ble.conftest import absence
from tests.rigs.bluetooth import ON_BLUEZ, Bluetooth
from tests.rigs.probe import DEADLINE_S, SERIAL, Probe, choice, generic_choice, refusal

if TYPE_CHECKING:
    from tests.rigs.bluez import FakeBluez

pytestmark = [pytest.mark.nightly, ON_BLUEZ]

# What only BlueZ can do to a Bluetooth LE link.


async def test_a_daemon_that_dies_shows_in_the_next_request(
    link: BleLink, bluez: FakeBluez
) -> None:
    bluez.die()
    error = await refusal(link.read(SERIAL))
    assert error.reason is TransportReason.LOST
    assert "this computer's Bluetooth system fails" in str(error)
    await link.close()
    again = BleLink(choice("1"))
    assert (await refusal(again.open())).reason is TransportReason.UNAVAILABLE
    bluez.rise()
    await again.open()
    assert await again.read(SERIAL) == b"0815"
    await again.close()


async def test_a_bus_that_dies_ends_the_link(link: BleLink, bluez: FakeBluez) -> None:
    bluez.kill_bus()
    assert (await refusal(link.next())).reason is TransportReason.LOST
    await link.close()
    error = await refusal(BleLink(choice("1")).open())
    assert error.reason is TransportReason.UNAVAILABLE


@pytest.mark.parametrize("at_once", [True, False])
async def test_a_device_that_bluez_forgets_after_the_scan_is_looked_for_again(
    probe: Probe, bluez: FakeBluez, at_once: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    connect, attempts = BleakClient.connect, list[BleakClient]()

    async def noted(self: BleakClient, **options: Any) -> None:
        attempts.append(self)
        if len(attempts) == 1 and not at_once:
            # Too late for bleak to notice before it asks.
            bluez.forget(probe.address)
        bluez.forgets_after_scan = False
        await connect(self, **options)

    monkeypatch.setattr(BleakClient, "connect", noted)
    bluez.forgets_after_scan = at_once
    link = BleLink(choice("1"))
    await link.open()
    assert await link.read(SERIAL) == b"0815"
    assert len(attempts) == 2
    await link.close()


async def test_a_named_device_that_was_left_connected_is_freed(link: BleLink) -> None:
    """The first link is that of a program which was killed: nobody closes it."""
    again = BleLink(choice("1"))
    await again.open()
    assert await again.read(SERIAL) == b"0815"
    assert (await refusal(link.next())).reason is TransportReason.LOST
    await again.close()


@pytest.mark.parametrize("device", ["", "2"])
async def test_no_other_device_is_taken_away(link: BleLink, device: str) -> None:
    await absence(BleLink(choice(device)))
    assert await link.read(SERIAL) == b"0815"


async def test_it_is_taken_once(link: BleLink) -> None:
    """Whoever connects to it after that has a right to it."""
    chosen = choice("1")
    first = BleLink(chosen)
    await first.open()
    error = await absence(BleLink(chosen))
    assert "is already connected to this computer" in str(error)
    assert await first.read(SERIAL) == b"0815"
    await first.close()


# Devices that BlueZ keeps connected for a program that was killed, or for one that runs.
@contextmanager
def _program(*arguments: str) -> Generator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "tests.rigs.probe_listener", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        try:
            yield program
        finally:
            program.kill()


async def _said(program: subprocess.Popen[str]) -> str:
    assert program.stdout
    return (await asyncio.to_thread(program.stdout.readline)).strip()


@pytest.fixture
async def listener(bluetooth: Bluetooth, probe: Probe) -> AsyncGenerator[subprocess.Popen[str]]:
    """A program that is connected to the probe, and is notified."""
    del bluetooth, probe
    with _program() as program:
        assert await _said(program) == "listening"
        yield program


async def _nobody_listens() -> None:
    """Wait until BlueZ has noticed it."""
    async with asyncio.timeout(DEADLINE_S):
        while True:
            if not any(each.is_listened_to for each in await known_devices()):
                return
            await asyncio.sleep(0.05)


@pytest.mark.usefixtures("hurry")
@pytest.mark.parametrize("device", ["", "Probe 1"])
async def test_a_device_that_a_killed_program_left_is_freed(
    listener: subprocess.Popen[str], probe: Probe, device: str
) -> None:
    listener.kill()
    await _nobody_listens()
    link = BleLink(choice(device))
    with capture_logs() as logs:
        assert (await link.open()).address == probe.address
    assert f"is still connected to this computer (Probe 1 {probe.address})" in logs[0]["event"]
    assert await link.read(SERIAL) == b"0815"
    await link.close()


@pytest.mark.usefixtures("hurry")
@pytest.mark.parametrize("device", ["", "Probe 1"])
async def test_a_device_that_a_program_listens_to_is_named_and_not_taken(
    listener: subprocess.Popen[str], probe: Probe, device: str
) -> None:
    error = await absence(BleLink(choice(device)))
    assert "is already connected to this computer; end the program that uses it" in str(error)
    assert str(error).endswith(f"free it: bluetoothctl disconnect {probe.address}")
    (known,) = await known_devices()
    assert (known.is_connected, known.is_listened_to) == (True, True)


@pytest.mark.usefixtures("hurry")
async def test_a_kind_that_has_others_in_it_frees_nothing_of_theirs(
    bluetooth: Bluetooth, probe: Probe
) -> None:
    link = BleLink(choice())
    await link.open()
    await absence(BleLink(generic_choice()))
    assert await link.read(SERIAL) == b"0815"
    await link.close()
