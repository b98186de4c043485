"""What BlueZ does and no other system: how the driver of a belt takes it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from structlog.testing import capture_logs

from biosensor_gateway.agent.device_states import State
from biosensor_gateway.devices.vernier_respiration_belt.simulator import SimulatedBelt
from tests.rigs.bluetooth import ON_BLUEZ
from tests.rigs.driver_run import streaming
from tests.rigs.polling import until
from tests.rigs.vernier_respiration_belt import assert_true

if TYPE_CHECKING:
    from tests.rigs.bluez import FakeBluez

pytestmark = ON_BLUEZ


async def test_a_daemon_that_dies_without_a_word_is_noticed_and_waited_for(
    belt: SimulatedBelt, bluez: FakeBluez
) -> None:
    async with streaming(belt) as run:
        await until(run.sink.has(5, "force"))
        with capture_logs() as logs:
            bluez.die()
            await until(lambda: State.BACKOFF in run.states)
        said = [entry["event"] for entry in logs]
        assert any("no data of bpm, force" in event for event in said)
        assert any("the Bluetooth system of this computer fails" in event for event in said)
        assert "Bluetooth is unavailable" in str(run.supervisor.last_error)
        bluez.rise()
        await run.goes_on(5, "force")
        assert run.supervisor.connections == 2
    assert_true(run.sink, belt)


async def test_a_connection_that_fails_is_tried_again(
    belt: SimulatedBelt, bluez: FakeBluez
) -> None:
    bluez.connect_error = "le-connection-refused"
    async with streaming(belt) as run:
        await until(lambda: State.DISCOVERING in run.states)
        assert "le-connection-refused" in str(run.supervisor.last_error)
        bluez.connect_error = ""
        await until(run.sink.has(5, "force"))
        assert State.BACKOFF not in run.states
