"""Other devices at the port: they are said to be what they are."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import pytest

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.driver import Found
from biosensor_gateway.devices.zephyr import driver as module
from biosensor_gateway.devices.zephyr.driver import DRIVER, ZephyrSettings, recognise
from biosensor_gateway.devices.zephyr.driver.protocol import ZephyrProtocol
from biosensor_gateway.transports.nearby import Advertisement, SerialPort
from tests.rigs.driver_run import NotedSink

HXM = (Path(__file__).parent / "vectors" / "zephyr_hxm_10_frames.dat").read_bytes()
FRAME_BYTES = 60


class Deaf:
    """A link to what sends a frame once a second and heeds nothing."""

    def __init__(self, frames: Callable[[int], bytes]) -> None:
        self._frames = frames
        self._sent = 0

    async def open(self) -> None: ...

    def write(self, data: bytes) -> None: ...

    async def read(self) -> tuple[bytes, float]:
        await asyncio.sleep(1.0)
        self._sent += 1
        return self._frames(self._sent - 1), asyncio.get_running_loop().time()

    async def close(self) -> None: ...


def hxm(number: int) -> bytes:
    begin = number % 10 * FRAME_BYTES
    return HXM[begin : begin + FRAME_BYTES]


def gps(_number: int) -> bytes:
    return b"$GPGGA,12*7"


def silence(_number: int) -> bytes:
    return b""


@pytest.mark.parametrize(
    ("frames", "reason", "what"),
    [
        (hxm, ProtocolReason.UNSUPPORTED, "a Zephyr HxM, which is not read"),
        (gps, ProtocolReason.GARBAGE, "no BioHarness"),
        (silence, ProtocolReason.NO_REPLY, "does not answer"),
    ],
)
async def test_it_is_said_what_answers(
    monkeypatch: pytest.MonkeyPatch,
    frames: Callable[[int], bytes],
    reason: ProtocolReason,
    what: str,
) -> None:
    def answering(_port: object) -> Deaf:
        return Deaf(frames)

    monkeypatch.setattr(module, "byte_link", answering)
    settings = ZephyrSettings.model_validate({"sensor": "zephyr", "unit": "1", "port": "COM7"})
    made = DRIVER.make(settings, NotedSink("zephyr"))()
    with pytest.raises(ProtocolError, match=what) as caught:
        await made.connect()
    assert caught.value.reason is reason
    await made.close()


def test_real_frames_of_it_are_whole() -> None:
    protocol = ZephyrProtocol()
    assert len(protocol.feed(HXM)) == 10
    assert protocol.dropped_bytes == 0


@pytest.mark.parametrize("name", ["BH BHT012345", "BHBHT012345"])
def test_a_paired_bioharness_is_found_by_the_name_of_its_port(name: str) -> None:
    settings = {"unit": "BHT012345", "port": "COM7"}
    assert recognise(SerialPort("COM7", name)) == Found("zephyr", name, settings)


@pytest.mark.parametrize(
    "seen",
    [
        SerialPort("COM7"),
        SerialPort("COM7", "Shimmer3-1234"),
        SerialPort("COM7", "BH BHT012345 2"),
        Advertisement("00:07:80:5A:3E:7E", "BH BHT012345"),
    ],
)
def test_others_are_none(seen: SerialPort | Advertisement) -> None:
    assert recognise(seen) is None
