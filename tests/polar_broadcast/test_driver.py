"""The driver on the virtual air, besides what holds for any."""

from __future__ import annotations

import asyncio

import pytest

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.polar_broadcast.driver import identify, recognise
from biosensor_gateway.devices.polar_broadcast.simulator import SimulatedPolarBroadcast
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.doctor.scan import drivers_by_precedence, recognised
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.transports.nearby import Advertisement, SerialPort
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import connected, streaming
from tests.rigs.polling import until

HEART_RATE = "0000180d-0000-1000-8000-00805f9b34fb"
RATE = {0x006B: bytes.fromhex("3b1b5452")}


@ON_BUMBLE
async def test_it_is_heard_with_its_name_and_at_its_time(radio: Radio) -> None:
    with SimulatedPolarBroadcast(radio.world, radio, device_id="CAFE0001") as strap:
        async with streaming(strap) as run:
            await until(run.sink.has(8, "hr", "hr_fast"))
        assert (run.sink.info.model, run.sink.info.serial_number) == ("H9", "CAFE0001")
        assert set(run.sink.values("rssi")) == {-66}
        truth = strap.truth.samples("hr")
        late_s = [
            min(heard_s - measured_s for measured_s in truth.times if measured_s <= heard_s)
            for heard_s in run.sink.times["hr"]
        ]
        assert max(late_s) < 0.1
        assert run.sink.losses == {}


async def test_a_strap_that_is_connected_to_is_listened_to_as_well(radio: Radio) -> None:
    """Whoever only listens neither takes the device for himself nor frees it for himself."""
    with (
        SimulatedPolarBroadcast(radio.world, radio) as strap,
        SimulatedPolarH10(radio.world, radio) as h10,
    ):
        async with streaming(strap) as heard, streaming(h10) as linked:
            await until(heard.sink.has(3, "hr"))
            await until(linked.sink.has(3, "hr"))
            assert linked.supervisor.connections == 1


async def test_a_counter_that_stands_is_a_reason(radio: Radio) -> None:
    with SimulatedPolarBroadcast(radio.world, radio) as strap:
        async with streaming(strap) as run:
            await until(run.sink.has(3, "hr"))
            strap.apply(Fault(FaultKind.STALL, 60.0))
            await until(lambda: run.supervisor.state is not State.STREAMING)
            assert "no data of hr" in run.error
            count = len(run.sink.rows["hr"])
            strap.clear(FaultKind.STALL)
            await until(run.is_streaming)
            assert len(run.sink.rows["hr"]) > count - 1


@ON_BUMBLE
async def test_who_goes_out_of_range_is_looked_for_and_what_was_missed_is_counted(
    radio: Radio, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    with SimulatedPolarBroadcast(radio.world, radio) as strap:
        async with streaming(strap) as run:
            await until(run.sink.has(5, "hr"))
            strap.apply(Fault(FaultKind.DROP, 20.0))
            await until(lambda: "is not heard any more" in run.error)
            await run.goes_on(3, "hr")
        assert run.supervisor.connections == 2
        assert run.sink.lost_count("hr") == strap.truth.unsent_count("hr")


async def test_a_device_that_tells_no_rate_is_said_to_tell_none(radio: Radio) -> None:
    with SimulatedPolarBroadcast(radio.world, radio) as strap:
        strap.apply(Fault(FaultKind.UNREADABLE, 60.0))
        # What was advertised before is over.
        await asyncio.sleep(2.0)
        with pytest.raises(ProtocolError, match="hold no heart rate") as caught:
            async with connected(strap):
                pass
        assert caught.value.reason is ProtocolReason.UNSUPPORTED


def test_it_is_found_with_the_settings_that_lead_to_it() -> None:
    found = recognise(
        Advertisement("A0:9E:1A:00:00:01", "Polar H7 7D4940C1", -60, frozenset(), RATE)
    )
    assert found is not None
    assert found.settings == {"unit": "7D4940C1", "device": "7D4940C1"}
    nameless = Advertisement("A0:9E:1A:00:00:01", manufacturer_data=RATE)
    assert identify(nameless) == nameless.address
    assert recognise(Advertisement("A0:9E:1A:00:00:01", "Polar 360 7D4940C1")) is None
    assert recognise(SerialPort("COM7")) is None


@pytest.mark.parametrize(
    ("model", "services", "sensor"),
    [
        ("H10", frozenset({HEART_RATE}), "polar_h10"),
        ("H9", frozenset({HEART_RATE}), "ble_heart_rate"),
        ("H9", frozenset[str](), "polar_broadcast"),
        ("Vantage M", frozenset[str](), "polar_broadcast"),
    ],
)
def test_scan_offers_a_connection_where_there_is_one(
    model: str, services: frozenset[str], sensor: str
) -> None:
    seen = Advertisement("A0:9E:1A:00:00:01", f"Polar {model} A1B2C3D4", -60, services, RATE)
    found = recognised(drivers_by_precedence(), seen)
    assert found is not None
    assert found.sensor == sensor
