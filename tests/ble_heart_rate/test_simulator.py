"""The virtual strap on the virtual radio, heard through plain bleak."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import numpy as np
import pytest

from biosensor_gateway.devices.ble_heart_rate.simulator import SimulatedHeartRateStrap
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World
from tests.rigs.gatt_host import GattHost, advertised, connection
from tests.rigs.polling import until

MEASUREMENT, LOCATION, BATTERY = "2a37", "2a38", "2a19"
NAME = "Heart Strap 0001"


@pytest.fixture
def radio(virtual_world: World) -> Iterator[Radio]:
    radio = Radio(virtual_world)
    with virtual_bluetooth(radio):
        yield radio


@pytest.fixture
def strap(radio: Radio) -> Iterator[SimulatedHeartRateStrap]:
    wearer = Wearer(heart_rate_bpm=150.0)
    with SimulatedHeartRateStrap(radio.world, radio, wearer=wearer, rssi_dbm=-66) as strap:
        yield strap


async def test_it_is_advertised_as_what_it_is(strap: SimulatedHeartRateStrap) -> None:
    device, data = await advertised(NAME)
    assert device.address == strap.settings["device"]
    assert data.service_uuids == ["0000180d-0000-1000-8000-00805f9b34fb"]
    assert data.rssi == -66


async def test_it_says_who_it_is_and_where_it_is_worn(strap: SimulatedHeartRateStrap) -> None:
    async with connection(NAME) as host:
        read = host.client.read_gatt_char
        assert bytes(await read(LOCATION)) == b"\1"
        texts = [bytes(await read(uuid)) for uuid in ("2a29", "2a24", "2a25", "2a26")]
        assert texts == [b"Virtual Straps", b"Heart Strap", b"0001", b"1.0"]
        before_s = strap.world.clock()
        assert bytes(await read(BATTERY)) == b"\x57"
    battery, signal = strap.truth.samples("bat"), strap.truth.samples("rssi")
    assert battery.values.tolist() == [[87.0]]
    assert before_s <= battery.times[0] <= strap.world.clock()
    assert signal.values.tolist() == [[-66.0]]


async def test_nothing_is_true_that_nobody_asked_for(strap: SimulatedHeartRateStrap) -> None:
    async with connection(NAME) as host:
        await asyncio.sleep(1.1)
        assert "hr" not in strap.truth.data_names
        assert not host.heard


async def test_a_fast_oscillator_makes_its_seconds_short(
    radio: Radio, strap: SimulatedHeartRateStrap
) -> None:
    del strap  # two on one air
    name = "Heart Strap 0002"
    with SimulatedHeartRateStrap(
        radio.world, radio, address="C8:25:00:00:00:02", name=name, jitter_s=0.05, seed=5
    ) as other:
        other.apply(Fault(FaultKind.DRIFT, 20_000.0))
        async with connection(name) as host:
            await _hear_rates(host, 4)
        times = other.truth.samples("hr").times
    np.testing.assert_allclose(np.diff(times), 1 / 1.02, atol=1e-6)


async def _hear_rates(host: GattHost, count: int) -> None:
    await host.subscribe(MEASUREMENT)
    await until(lambda: sum(bool(data[1]) for data in host.all(MEASUREMENT)) >= count)
