"""The driver reads the virtual device, on every rig."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.agent.state import State
from biosensor_gateway.devices.bluetooth_health.driver import recognise
from biosensor_gateway.devices.bluetooth_health.driver.services import SPOT_CHECK
from biosensor_gateway.doctor.scan import drivers_by_precedence, recognised
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_errors import AttError
from biosensor_gateway.transports.nearby import Advertisement, SerialPort
from tests.rigs.bluetooth import ON_BUMBLE
from tests.rigs.driver_run import connected, streaming
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order

if TYPE_CHECKING:
    from biosensor_gateway.devices.bluetooth_health.simulator import SimulatedHealthDevice

STREAMS = ("spo2", "temp", "running", "power")


async def test_every_stream_fills_with_what_the_device_sent(device: SimulatedHealthDevice) -> None:
    async with streaming(device) as run:
        await until(run.sink.has(4, *STREAMS, "cycling", "quality"))
        assert run.states == [State.CONNECTING, State.STREAMING]
        assert run.sink.info.manufacturer == "Virtual Health"
    for name in STREAMS:
        assert_once_and_in_order(run.sink.rows[name], device.truth.samples(name).values)
    # Two turns a second of 2.105 m, and 75 of the crank a minute.
    np.testing.assert_allclose(np.nanmedian(run.sink.rows["cycling"], axis=0), [4.21, 75.0], 1e-3)
    assert set(run.sink.values("quality")) == {1}
    assert run.sink.rows["bat"] == [[87]]
    assert run.sink.rows["rssi"] == [[-67]]
    assert run.sink.dropped_bytes == 0


@ON_BUMBLE
async def test_without_a_finger_there_is_no_saturation(device: SimulatedHealthDevice) -> None:
    async with streaming(device) as run:
        await until(run.sink.has(2, "spo2"))
        device.apply(Fault(FaultKind.OFF_BODY, 3600.0))
        await until(lambda: run.sink.values("quality")[-1] == 0)
        count = len(run.sink.rows["spo2"])
        await run.goes_on(3, "temp")
        assert len(run.sink.rows["spo2"]) == count
        assert run.supervisor.connections == 1


@ON_BUMBLE
async def test_services_that_it_does_not_have_are_not_waited_for(
    device: SimulatedHealthDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    has = BleLink.has

    def without_oximeter(link: BleLink, uuid: str) -> bool:
        return "2a5f" not in uuid and has(link, uuid)

    monkeypatch.setattr(BleLink, "has", without_oximeter)
    async with connected(device) as info:
        assert info.refused == {"spo2"}
        assert not info.due


@ON_BUMBLE
async def test_a_device_without_any_is_said(
    device: SimulatedHealthDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    def has_nothing(_link: BleLink, _uuid: str) -> bool:
        return False

    monkeypatch.setattr(BleLink, "has", has_nothing)
    with pytest.raises(ProtocolError, match="has none of the services") as caught:
        async with connected(device):
            pass
    assert caught.value.reason is ProtocolReason.UNSUPPORTED


@pytest.mark.parametrize("service", ["1822", "1809", "1814", "1816", "1818"])
def test_a_device_is_found_by_any_of_its_services(service: str) -> None:
    uuid = f"0000{service}-0000-1000-8000-00805f9b34fb"
    seen = Advertisement("C8:26:00:00:00:01", "Nonin3230_1", -60, frozenset({uuid}))
    found = recognised(drivers_by_precedence(), seen)
    assert found is not None
    assert (found.sensor, found.name) == ("bluetooth_health", "Nonin3230_1")


@ON_BUMBLE
async def test_a_service_that_is_refused_is_said_and_the_others_come(
    device: SimulatedHealthDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    subscribe = BleLink.subscribe

    async def refused(link: BleLink, uuid: str) -> None:
        if uuid.startswith("00002a5f"):
            raise AttError(0x80, link.what)
        await subscribe(link, uuid)

    monkeypatch.setattr(BleLink, "subscribe", refused)
    async with streaming(device) as run:
        await until(run.sink.has(2, "temp", "running", "power"))
        assert run.supervisor.last_error == (
            "connected, but the device refuses spo2 "
            "(its service lets nobody subscribe: ATT error 0x80)"
        )


@ON_BUMBLE
async def test_an_oximeter_with_spot_checks_alone_is_told_from_others(
    device: SimulatedHealthDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    def has(link: BleLink, uuid: str) -> bool:
        del link
        return uuid == SPOT_CHECK

    monkeypatch.setattr(BleLink, "has", has)
    with pytest.raises(ProtocolError, match="has only spot checks"):
        async with connected(device):
            pass


def test_anything_else_is_none() -> None:
    assert recognise(Advertisement("C8:26:00:00:00:01", "Nonin3230_1", -60)) is None
    assert recognise(SerialPort("COM7", "Nonin3230_1")) is None
