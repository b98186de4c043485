"""A virtual health device on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from biosensor_gateway.devices.bluetooth_health.simulator import SimulatedHealthDevice
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.transports import ble_choice
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook


@pytest.fixture
def device(
    switch_on: Callable[..., SimulatedHealthDevice], monkeypatch: pytest.MonkeyPatch
) -> SimulatedHealthDevice:
    """One that is switched on."""
    monkeypatch.setattr(ble_choice, "OTHERS_S", 0.5)
    return switch_on(SimulatedHealthDevice, wearer=Wearer(seed=3), rssi_dbm=-67)
