"""A virtual heart-rate strap on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Generator

import pytest

from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.devices.ble_heart_rate.simulator import SimulatedHeartRateStrap
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.transports import ble_choice
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook


@pytest.fixture
def strap(radio: Radio, monkeypatch: pytest.MonkeyPatch) -> Generator[SimulatedHeartRateStrap]:
    """One that is switched on; it is looked for without long pauses."""
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(supervisor_module, "BACKOFF_FIRST_S", 0.1)
    # Not shorter: a second strap has to be heard in that time.
    monkeypatch.setattr(ble_choice, "OTHERS_S", 2.0)
    wearer = Wearer(seed=3, heart_rate_bpm=160)
    with SimulatedHeartRateStrap(radio.world, radio, wearer=wearer, rssi_dbm=-67) as strap:
        yield strap
