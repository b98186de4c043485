"""What any driver of a Bluetooth LE device does when this computer's Bluetooth goes away."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, cast

import pytest

from biosensor_gateway.agent.device_states import State
from biosensor_gateway.demo.virtual_devices import one_of_each, virtual_class
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from tests.rigs.bluetooth import SEAM_ON_BLUEZ
from tests.rigs.driver_run import streaming
from tests.rigs.polling import until
from tests.rigs.truth import assert_once_and_in_order

if TYPE_CHECKING:
    from tests.rigs.bluez import FakeBluez

pytestmark = pytest.mark.nightly

NAMES = [name for name in one_of_each() if virtual_class(name).on_air]


@SEAM_ON_BLUEZ
@pytest.mark.parametrize("name", NAMES)
async def test_an_adapter_that_is_switched_off_is_waited_for(
    radio: Radio, bluez: FakeBluez, name: str
) -> None:
    make = cast("Callable[..., VirtualDevice]", virtual_class(name))
    with make(radio.world, radio) as device:
        async with streaming(device) as run:
            await until(lambda: any(run.sink.rows[each] for each in device.truth.data_names))
            bluez.set_powered(False)
            await until(lambda: State.BACKOFF in run.states)
            assert "Bluetooth is unavailable" in str(run.supervisor.last_error)
            before = {each: len(rows) for each, rows in run.sink.rows.items()}
            bluez.set_powered(True)
            await until(lambda: run.supervisor.connections == 2)
            await until(
                lambda: any(
                    len(run.sink.rows[each]) > before[each] + 4
                    for each in device.truth.data_names
                    if each not in device.expected.by_agent
                )
            )
            assert run.supervisor.connections == 2
        for each in set(device.truth.data_names) - device.expected.by_agent:
            assert_once_and_in_order(run.sink.rows[each], device.truth.samples(each).values)
