"""What BlueZ does and no other system: how the driver of a heart-rate strap takes it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.ble_heart_rate.driver import HeartRateStrapDriver
from biosensor_gateway.devices.ble_heart_rate.simulator import SimulatedHeartRateStrap
from tests.rigs.bluetooth import ON_BLUEZ
from tests.rigs.driver_run import streaming
from tests.rigs.polling import until

if TYPE_CHECKING:
    from tests.rigs.bluez import FakeBluez

pytestmark = ON_BLUEZ


async def test_a_daemon_that_dies_without_a_word_is_noticed_and_waited_for(
    strap: SimulatedHeartRateStrap, bluez: FakeBluez, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(HeartRateStrapDriver, "silence_limit_s", 2.0)
    async with streaming(strap) as run:
        await until(run.sink.has(1, "hr", "bat"))
        bluez.die()
        # Nobody asks a strap for anything, so it is its silence that tells.
        await until(lambda: State.BACKOFF in run.states)
        assert "Bluetooth is unavailable" in str(run.supervisor.last_error)
        bluez.rise()
        await run.goes_on(1, "hr")
        assert run.supervisor.connections == 2
        # It is read at every connection, and what is read must not be notified as well.
        await until(run.sink.has(2, "bat"))
    assert run.sink.values("bat") == [87, 87]


async def test_a_strap_that_bluez_forgets_after_the_scan_is_looked_for_until_it_does_not(
    strap: SimulatedHeartRateStrap, bluez: FakeBluez
) -> None:
    bluez.forgets_after_scan = True
    async with streaming(strap) as run:
        await until(lambda: State.DISCOVERING in run.states)
        assert "does not connect" in str(run.supervisor.last_error)
        bluez.forgets_after_scan = False
        await until(run.sink.has(1, "hr"))
        assert State.BACKOFF not in run.states
