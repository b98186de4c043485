"""A virtual heart-rate strap on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from biosensor_gateway.devices.ble_heart_rate.simulator import SimulatedHeartRateStrap
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.transports import ble_choice
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook


@pytest.fixture
def strap(
    switch_on: Callable[..., SimulatedHeartRateStrap], monkeypatch: pytest.MonkeyPatch
) -> SimulatedHeartRateStrap:
    """One that is switched on."""
    # Not shorter: a second strap has to be heard in that time.
    monkeypatch.setattr(ble_choice, "OTHERS_S", 2.0)
    return switch_on(
        SimulatedHeartRateStrap, wearer=Wearer(seed=3, heart_rate_bpm=160), rssi_dbm=-67
    )
