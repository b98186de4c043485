"""Virtual Polar sensors on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from biosensor_gateway.devices.polar_h10.simulator.products import Quirks
from biosensor_gateway.simulation.wearer import Wearer
from tests.polar_h10.steering import SteeredPolarH10
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook

Make = Callable[..., SteeredPolarH10]


@pytest.fixture
def sensor(switch_on: Make) -> Make:
    """Switch a sensor on for the rest of the test."""

    def make(quirks: Quirks | None = None, **options: Any) -> SteeredPolarH10:
        wearer = Wearer(seed=5, heart_rate_bpm=100)
        return switch_on(SteeredPolarH10, quirks=quirks, wearer=wearer, **options)

    return make
