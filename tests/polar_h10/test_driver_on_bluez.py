"""What BlueZ does and no other system: how the driver of a Polar sensor takes it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from structlog.testing import capture_logs

from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.polar_h10 import driver as driver_module
from biosensor_gateway.devices.polar_h10.driver.protocol.control_point import CONTROL_POINT
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.devices.polar_h10.simulator.products import Quirks
from biosensor_gateway.simulation.faults import Fault, FaultKind
from biosensor_gateway.transports.ble import BleLink, Notification
from tests.rigs.bluetooth import ON_BLUEZ
from tests.rigs.driver_run import streaming
from tests.rigs.polling import until
from tests.rigs.truth import assert_only_gaps

if TYPE_CHECKING:
    from tests.rigs.bluez import FakeBluez

pytestmark = ON_BLUEZ

MakeSensor = Callable[..., SimulatedPolarH10]
FRAME = 73


async def test_a_daemon_that_dies_without_a_word_is_noticed_and_waited_for(
    sensor: MakeSensor, bluez: FakeBluez, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "PATIENCE_S", 1.5)
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(FRAME, "ecg"))
        with capture_logs() as logs:
            bluez.die()
            await until(lambda: State.BACKOFF in run.states)
        said = [entry["event"] for entry in logs]
        assert any("enabling again" in event for event in said)
        assert any("this computer's Bluetooth system fails" in event for event in said)
        assert "Bluetooth is unavailable" in str(run.supervisor.last_error)
        bluez.rise()
        await run.goes_on(FRAME, "ecg")
        assert run.supervisor.connections == 2
    assert_only_gaps(h10, run.sink, "ecg", "acc")


async def test_a_daemon_that_is_back_before_anybody_noticed_costs_one_connection(
    sensor: MakeSensor, bluez: FakeBluez, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver_module, "PATIENCE_S", 1.5)
    h10 = sensor()
    async with streaming(h10) as run:
        await until(run.sink.has(FRAME, "ecg"))
        bluez.die()
        bluez.rise()
        await until(lambda: run.supervisor.connections == 2)
        assert State.BACKOFF not in run.states
        await run.goes_on(FRAME, "ecg")
    assert_only_gaps(h10, run.sink, "ecg", "acc")


@pytest.mark.parametrize(
    ("is_worded", "cause"), [(False, "ATT error 0x0E"), (True, "ATT error 0x05")]
)
async def test_a_demand_for_pairing_is_understood_however_bluez_puts_it(
    sensor: MakeSensor, bluez: FakeBluez, is_worded: bool, cause: str
) -> None:
    bluez.words_security = is_worded
    h10 = sensor(Quirks(demands_pairing=True))
    with capture_logs() as logs:
        async with streaming(h10) as run:
            await until(run.sink.has(FRAME, "ecg"))
            assert run.states == [State.CONNECTING, State.STREAMING]
    causes = [entry["cause"] for entry in logs if entry["event"].startswith("pairing")]
    assert len(causes) == 1
    assert cause in causes[0]


async def test_a_value_that_is_read_is_no_answer_and_no_sample(
    sensor: MakeSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """BlueZ passes what anybody on the computer reads on to all who are subscribed."""
    write, take = BleLink.write, BleLink.next
    heard: list[Notification] = []

    async def write_then_read(link: BleLink, uuid: str, *data: Any, **options: Any) -> None:
        await write(link, uuid, *data, **options)
        await link.read(CONTROL_POINT)

    async def noted(link: BleLink) -> Notification:
        heard.append(await take(link))
        return heard[-1]

    monkeypatch.setattr(BleLink, "write", write_then_read)
    monkeypatch.setattr(BleLink, "next", noted)
    h10 = sensor()
    # So that the replies come after the values.
    h10.apply(Fault(FaultKind.LATE, 1.0))
    async with streaming(h10) as run:
        await until(run.sink.has(FRAME, "ecg"))
        await until(run.sink.has(36, "acc"))
        await until(run.sink.has(1, "bat"))
        assert run.states == [State.CONNECTING, State.STREAMING]
    kinds = [each.data[0] for each in heard if each.uuid == CONTROL_POINT]
    # Settings and start of two measurements; each time the value first, then the reply.
    assert kinds[:8] == [0x0F, 0xF0] * 4
    assert_only_gaps(h10, run.sink, "ecg", "acc")
    assert run.sink.rows["bat"] == [[87]]
    assert run.sink.dropped_bytes == 0
