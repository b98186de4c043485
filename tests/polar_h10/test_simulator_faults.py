"""What can go wrong with the virtual Polar H10, as a host meets it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import numpy as np
import pytest
from bleak import BleakScanner

from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.devices.polar_h10.simulator.products import Firmware, Quirks
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.world import World
from tests.rigs.gatt_host import GattHost, connection
from tests.rigs.polling import until

HEART_RATE, BATTERY = "2a37", "2a19"
CONTROL = "fb005c81-02e7-f387-1cad-8acd2d8df0c8"
DATA = "fb005c82-02e7-f387-1cad-8acd2d8df0c8"
NAME = "Polar H10 A1B2C3D4"
START_ECG = "020000018200 01010e00"
STARTED = "f002000000"
POWER_ON_NS = 599_616_000_000_000_000
LONG_S = 120.0
MakeH10 = Callable[..., SimulatedPolarH10]


@pytest.fixture
def make_h10(virtual_world: World) -> Iterator[MakeH10]:
    with ExitStack() as stack:
        world = virtual_world
        radio = Radio(world)
        stack.enter_context(virtual_bluetooth(radio))

        def make(quirks: Quirks | None = None, off_body_drop_s: float = 0) -> SimulatedPolarH10:
            limit_s = off_body_drop_s or float("inf")
            made = SimulatedPolarH10(world, radio, quirks=quirks, off_body_drop_s=limit_s)
            return stack.enter_context(made)

        yield make


@pytest.fixture
def h10(make_h10: MakeH10) -> SimulatedPolarH10:
    return make_h10()


async def stream_ecg(host: GattHost) -> None:
    await host.subscribe(CONTROL, DATA)
    assert await host.ask(CONTROL, START_ECG) == STARTED
    await host.more(DATA, 1)


def stamp_ns(frame: bytes) -> int:
    return int.from_bytes(frame[1:9], "little")


async def is_heard() -> bool:
    return any(device.name == NAME for device in await BleakScanner.discover(timeout=0.5))


async def test_no_host_gets_the_answer_to_another(h10: SimulatedPolarH10) -> None:
    h10.apply(Fault(FaultKind.LATE, 1.0))
    async with connection(NAME) as host:
        await host.subscribe(CONTROL)
        await host.client.write_gatt_char(CONTROL, b"\1\2", response=True)
    async with connection(NAME) as host:
        await host.subscribe(CONTROL)
        assert (await host.ask(CONTROL, "0100"))[:6] == "f00100"


async def test_a_restart_resets_the_clock_and_forgets_everything(
    h10: SimulatedPolarH10,
) -> None:
    async with connection(NAME) as host:
        await stream_ecg(host)
        await host.more(DATA, 2)
        last = stamp_ns(host.all(DATA)[-1])
        h10.apply(Fault(FaultKind.RESTART, LONG_S))
        await until(lambda: not host.client.is_connected)
    assert not await is_heard()
    h10.clear(FaultKind.RESTART)
    async with connection(NAME) as host:
        await host.subscribe(CONTROL, DATA)
        assert await host.ask(CONTROL, "05") == "f0050000000002"
        assert await host.ask(CONTROL, START_ECG) == STARTED
        (frame, *_) = await host.more(DATA, 1)
    assert POWER_ON_NS < stamp_ns(frame) < last


async def test_after_a_while_off_the_body_it_switches_itself_off(make_h10: MakeH10) -> None:
    h10 = make_h10(off_body_drop_s=0.5)
    async with connection(NAME) as host:
        await stream_ecg(host)
        h10.apply(Fault(FaultKind.OFF_BODY, LONG_S))
        await until(lambda: not host.client.is_connected)
    assert not await is_heard()
    h10.clear(FaultKind.OFF_BODY)
    async with connection(NAME) as host:
        await stream_ecg(host)


async def test_put_on_in_time_it_stays(make_h10: MakeH10) -> None:
    h10 = make_h10(off_body_drop_s=1.0)
    async with connection(NAME) as host:
        h10.apply(Fault(FaultKind.OFF_BODY, LONG_S))
        h10.clear(FaultKind.OFF_BODY)
        await stream_ecg(host)
        await host.more(DATA, 2)
        assert host.client.is_connected


async def test_drift_changes_what_the_stamps_say_of_the_truth(h10: SimulatedPolarH10) -> None:
    h10.apply(Fault(FaultKind.DRIFT, 10_000.0))
    async with connection(NAME) as host:
        await stream_ecg(host)
        await host.more(DATA, 2)
    np.testing.assert_allclose(np.diff(h10.truth.samples("ecg").times), 1 / 130 / 1.01)


@pytest.mark.parametrize("kind", list(SimulatedPolarH10.effects))
async def test_a_strap_without_pmd_survives_every_fault(make_h10: MakeH10, kind: FaultKind) -> None:
    h10 = make_h10(Quirks(firmware=Firmware.HEART_RATE_ONLY))
    h10.apply(Fault(kind, 5.0))
    h10.clear(kind)
    async with connection(NAME) as host:
        await host.subscribe(HEART_RATE)
        await host.more(HEART_RATE, 1)
