"""Devices that BlueZ keeps connected for a program that was killed, or for one that runs."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import AsyncGenerator, Generator
from contextlib import contextmanager

import pytest
from structlog.testing import capture_logs

from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.bluez import known_devices
from tests.ble.conftest import absence
from tests.rigs.bluetooth import ON_BLUEZ, Bluetooth
from tests.rigs.probe import SERIAL, Probe
from tests.rigs.probe_link import DEADLINE_S, choice, generic_choice

pytestmark = [pytest.mark.nightly, ON_BLUEZ, pytest.mark.usefixtures("hurry")]


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


@pytest.mark.parametrize("device", ["", "Probe 1"])
async def test_a_device_that_a_program_listens_to_is_named_and_not_taken(
    listener: subprocess.Popen[str], probe: Probe, device: str
) -> None:
    error = await absence(BleLink(choice(device)))
    assert "is connected to this computer already; end the program that uses it" in str(error)
    assert str(error).endswith(f"free it: bluetoothctl disconnect {probe.address}")
    (known,) = await known_devices()
    assert (known.is_connected, known.is_listened_to) == (True, True)


async def test_a_kind_that_has_others_in_it_frees_nothing_of_theirs(
    bluetooth: Bluetooth, probe: Probe
) -> None:
    link = BleLink(choice())
    await link.open()
    await absence(BleLink(generic_choice()))
    assert await link.read(SERIAL) == b"0815"
    await link.close()
