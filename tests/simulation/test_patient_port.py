"""A serial port that lets its host read what it was sent before the link breaks."""

from __future__ import annotations

import asyncio
import os
import sys
import tty
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress

import pytest

from biosensor_gateway.simulation.async_serial import PatientPort
from tests.rigs.polling import until

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are needed"),
]

DATA = bytes(range(256)) * 8
BUFFER_BYTES = 4096


class Device:
    """The port, and what a host has said."""

    def __init__(self) -> None:
        self.heard = bytearray()
        self.port = PatientPort(
            self.heard.extend, lambda: None, buffer_bytes=BUFFER_BYTES, tcp=False
        )
        self.port.open()

    @asynccontextmanager
    async def host(self) -> AsyncGenerator[int]:
        """Open the port as a host does, and say something: before that nothing is sent."""
        handle = os.open(self.port.name, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(handle)
        try:
            said = len(self.heard)
            os.write(handle, b"?")
            await until(lambda: len(self.heard) > said)
            yield handle
        finally:
            os.close(handle)


async def read_to_the_end(handle: int) -> bytes:
    """Read until the device has hung up."""
    read = bytearray()
    # That is how a pseudo-terminal says that it has.
    with suppress(OSError):
        while piece := await asyncio.to_thread(os.read, handle, 65536):
            read += piece
    return bytes(read)


async def test_a_host_that_is_behind_gets_all_that_was_sent() -> None:
    device = Device()
    async with device.host() as handle:
        assert device.port.write(DATA)
        device.port.hang_up()
        assert not device.port.write(b"more")
        await asyncio.sleep(0.3)
        assert await read_to_the_end(handle) == DATA
    device.port.dispose()


async def test_one_that_never_reads_loses_it_and_the_device_goes_on() -> None:
    device = Device()
    async with device.host() as handle:
        assert device.port.write(DATA)
        device.port.hang_up()
        device.port.open()
        # It opens once it has hung up.
        assert not device.port.write(b"more")
        await asyncio.sleep(2.0)
        assert await read_to_the_end(handle) == b""
    async with device.host() as handle:
        assert device.port.write(b"again")
        assert await asyncio.to_thread(os.read, handle, 100) == b"again"
    device.port.dispose()
