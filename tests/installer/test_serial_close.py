"""A serial port is closed under a read that waits, on Windows, without harm to the program."""

from __future__ import annotations

import os
import threading
import tty
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path

import pytest

from installer.layout import WORK
from installer.wine.prefix import windows_path
from tests.rigs.windows.pc import WindowsPc

pytestmark = [pytest.mark.system, pytest.mark.timeout(300)]

COM = 9
TIMES = 150
PACKET = bytes(8)
PACKET_EVERY_S = 0.004
SCRIPT = f"""
import asyncio

from biosensor_gateway.transports.serial_port import SerialLink


async def main():
    for _ in range({TIMES}):
        link = SerialLink("COM{COM}")
        await link.open()
        await link.read()
        await link.close()
    print("closed", {TIMES}, "times")


asyncio.run(main())
"""


@pytest.fixture
def talking_port() -> Generator[str]:
    """Path of a terminal on which a device sends packets."""
    master, terminal = os.openpty()
    tty.setraw(terminal)
    os.set_blocking(master, False)
    ended = threading.Event()

    def send() -> None:
        while not ended.wait(PACKET_EVERY_S):
            try:
                os.write(master, PACKET)
            except BlockingIOError:
                # Nobody has the port open just now, and its buffer is full.
                continue

    device = threading.Thread(target=send)
    device.start()
    yield os.ttyname(terminal)
    ended.set()
    device.join()
    os.close(master)
    os.close(terminal)


def test_closing_ends_the_read_first(
    installed: WindowsPc, tmp_path: Path, talking_port: str
) -> None:
    installed.plug_in(COM, talking_port)
    script = tmp_path / "close_often.py"
    script.write_text(SCRIPT)
    paths = ";".join(windows_path(WORK / each) for each in ("product", "packages"))
    environment = {**installed.prefix.environment, "PYTHONPATH": paths}
    prefix = replace(installed.prefix, environment=environment)
    said = prefix.run(WORK / "python" / "python.exe", windows_path(script))
    assert said.splitlines()[-1] == f"closed {TIMES} times"
