"""The virtual BioHarness on TCP, as where there are no pseudo-terminals."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Generator

import pytest

from biosensor_common.errors import TransportError, TransportReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.devices.zephyr.driver import DRIVER, ZephyrSettings
from biosensor_gateway.devices.zephyr.simulator.zephyr import SyntheticSource
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.transports.byte_links import TcpLink
from tests.rigs.zephyr import SteeredBioHarness

DEADLINE_S = 30.0


@pytest.fixture
def device() -> Generator[SteeredBioHarness]:
    with SteeredBioHarness(SyntheticSource(seed=2), tcp=True) as running:
        yield running


async def _until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, "it did not happen"
        await asyncio.sleep(0.02)


def _pushed(sink: DeviceSink) -> int:
    return next((c.pushed for name, c in sink.counters.items() if name.endswith("ecg")), 0)


async def test_a_driver_streams_and_comes_back_after_a_hang_up(
    device: SteeredBioHarness,
) -> None:
    settings = ZephyrSettings(sensor="zephyr", unit="TCP", port=device.port)
    sink = DeviceSink(DeviceIdentity("zephyr", "TCP"), declaration("zephyr"))
    supervisor = Supervisor(DRIVER.make(settings, sink), sink)
    task = asyncio.create_task(supervisor.run())
    try:
        await _until(lambda: _pushed(sink) > 200)
        await asyncio.to_thread(device.drop_link, 0.5)
        await _until(lambda: supervisor.connections == 2)
        before = _pushed(sink)
        await _until(lambda: _pushed(sink) > before + 200)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        sink.close()


async def test_while_it_hangs_up_connections_are_refused(device: SteeredBioHarness) -> None:
    await asyncio.to_thread(device.drop_link)
    host, _, port = device.port.removeprefix("socket://").partition(":")
    link = TcpLink(host, int(port))
    with pytest.raises(TransportError) as refused:
        await link.open()
    await link.close()
    assert refused.value.reason is TransportReason.ABSENT
