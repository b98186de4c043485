"""The same over the links that are in memory elsewhere: terminals, TCP, UDP, WebSockets and TLS."""

from __future__ import annotations

import pytest

from biosensor_gateway.simulation.virtual_device import VirtualDevice
from tests.contracts.test_any_driver import *  # noqa: F403 - all of them
from tests.contracts.test_any_driver import STREAMS, told_the_truth
from tests.contracts.test_any_virtual_device import *  # noqa: F403 - all of them

pytestmark = pytest.mark.nightly


@pytest.mark.seam
async def test_what_the_device_measures_arrives(device: VirtualDevice) -> None:
    async with told_the_truth(device) as run:
        assert run.supervisor.connections == 1
        assert run.states == STREAMS
