"""A virtual health device on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Generator

import pytest

from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.devices.bluetooth_health.simulator import SimulatedHealthDevice
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.transports import ble_choice
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook


@pytest.fixture
def device(radio: Radio, monkeypatch: pytest.MonkeyPatch) -> Generator[SimulatedHealthDevice]:
    """One that is switched on; it is looked for without long pauses."""
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(supervisor_module, "BACKOFF_FIRST_S", 0.1)
    monkeypatch.setattr(ble_choice, "OTHERS_S", 0.5)
    wearer = Wearer(seed=3)
    with SimulatedHealthDevice(radio.world, radio, wearer=wearer, rssi_dbm=-67) as device:
        yield device
