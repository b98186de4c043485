"""The virtual strap on the virtual radio, heard through plain bleak."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import numpy as np
import pytest
from bleak import BleakScanner

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


def decode(data: bytes) -> tuple[int, bool, list[int]]:
    """Return rate, contact and R-R intervals; this strap always tells contact, no energy."""
    flags = data[0]
    assert flags & 0x0D == 0x04
    return data[1], bool(flags & 2), np.frombuffer(data[2:], "<u2").tolist()


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


async def test_what_it_sends_is_the_truth(strap: SimulatedHeartRateStrap) -> None:
    async with connection(NAME) as host:
        await host.subscribe(MEASUREMENT)
        await host.more(MEASUREMENT, 4)
        heard = list(host.heard[MEASUREMENT])
    decoded = [decode(one.data) for one in heard]
    truth = {name: strap.truth.samples(name) for name in ("hr", "ibi", "quality")}
    rates = [rate for rate, _, _ in decoded if rate]
    intervals = [rr / 1024 for _, _, rrs in decoded for rr in rrs]
    assert truth["hr"].values[: len(rates), 0].tolist() == rates
    assert truth["ibi"].values[: len(intervals), 0].tolist() == intervals
    assert truth["quality"].values[:, 0].all()
    assert all(contact for _, contact, _ in decoded)
    assert len(intervals) >= 6
    assert rates[-1] == pytest.approx(150, abs=9)
    # Nothing is sent before it was measured.
    sent_s = [one.arrival for one, (rate, _, _) in zip(heard, decoded, strict=True) if rate]
    assert np.all(truth["hr"].times[: len(rates)] <= sent_s)
    np.testing.assert_allclose(np.diff(truth["hr"].times), 1.0)
    np.testing.assert_allclose(
        np.diff(truth["ibi"].times), truth["ibi"].values[1:, 0], atol=1 / 1024
    )


async def test_nothing_is_true_that_nobody_asked_for(strap: SimulatedHeartRateStrap) -> None:
    async with connection(NAME) as host:
        await asyncio.sleep(1.1)
        assert "hr" not in strap.truth.data_names
        assert not host.heard


async def test_off_the_body_it_tells_so_and_has_no_rate(strap: SimulatedHeartRateStrap) -> None:
    async with connection(NAME) as host:
        await host.subscribe(MEASUREMENT)
        await host.more(MEASUREMENT, 1)
        strap.apply(Fault(FaultKind.OFF_BODY, 60.0))
        await until(lambda: host.all(MEASUREMENT)[-1] == b"\x14\x00")
        strap.clear(FaultKind.OFF_BODY)
        count = len(host.all(MEASUREMENT))
        await until(lambda: any(decode(data)[2] for data in host.all(MEASUREMENT)[count:]))
        assert decode(host.all(MEASUREMENT)[-1])[1]
    quality = strap.truth.samples("quality").values[:, 0]
    assert {0.0, 1.0} == set(quality)
    # An interval never spans the time without contact.
    assert strap.truth.samples("ibi").values.max() < 0.6


async def test_a_low_battery_is_told_and_can_be_read(strap: SimulatedHeartRateStrap) -> None:
    async with connection(NAME) as host:
        await host.subscribe(BATTERY)
        strap.apply(Fault(FaultKind.LOW_BATTERY, 4.0))
        assert await host.more(BATTERY, 1, 0) == [b"\4"]
        assert bytes(await host.client.read_gatt_char(BATTERY)) == b"\4"
    assert set(strap.truth.samples("bat").values[:, 0]) == {4.0}


async def test_garbage_comes_beside_the_measurements(strap: SimulatedHeartRateStrap) -> None:
    async with connection(NAME) as host:
        await host.subscribe(MEASUREMENT)
        strap.apply(Fault(FaultKind.GARBAGE, 30.0))
        await host.more(MEASUREMENT, 32, 0)
        values = host.all(MEASUREMENT)
    short = [data for data in values if len(data) < 2 or (data[0] != 0x14 and data[0] & 0x0D != 4)]
    assert len(short) == 30
    kept = [decode(data)[0] for data in values if data not in short]
    assert strap.truth.samples("quality").values.shape[0] >= len(kept) == len(values) - 30


async def test_a_dropped_link_is_gone_until_it_returns(strap: SimulatedHeartRateStrap) -> None:
    async with connection(NAME) as host:
        strap.apply(Fault(FaultKind.DROP, 60.0))
        await until(lambda: not host.client.is_connected)
        found = await BleakScanner.discover(timeout=0.5)
        assert all(device.name != NAME for device in found)
    strap.clear(FaultKind.DROP)
    async with connection(NAME) as host:
        await host.subscribe(MEASUREMENT)
        await host.more(MEASUREMENT, 1)


async def test_what_a_stall_swallows_is_counted(strap: SimulatedHeartRateStrap) -> None:
    async with connection(NAME) as host:
        await host.subscribe(MEASUREMENT)
        await host.more(MEASUREMENT, 2)
        strap.apply(Fault(FaultKind.STALL, 60.0))
        count = len(host.all(MEASUREMENT))
        await until(lambda: strap.truth.unsent_count("quality") == 2)
        assert len(host.all(MEASUREMENT)) == count
        strap.clear(FaultKind.STALL)
        await host.more(MEASUREMENT, 1)
        assert host.client.is_connected
    assert strap.truth.unsent_count("ibi") >= 3


async def test_a_restart_ends_the_link_and_begins_again(strap: SimulatedHeartRateStrap) -> None:
    async with connection(NAME) as host:
        await host.subscribe(MEASUREMENT)
        await until(lambda: "ibi" in strap.truth.data_names)
        strap.apply(Fault(FaultKind.RESTART, 60.0))
        await until(lambda: not host.client.is_connected)
    strap.clear(FaultKind.RESTART)
    async with connection(NAME) as host:
        await host.subscribe(MEASUREMENT)
        await until(lambda: any(len(data) > 2 for data in host.all(MEASUREMENT)))
        decode(host.all(MEASUREMENT)[-1])


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
