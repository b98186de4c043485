"""Virtual optical sensors on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from biosensor_gateway.devices.polar_h10.simulator.products import Quirks
from biosensor_gateway.devices.polar_verity_sense.simulator import SimulatedPolarVeritySense
from biosensor_gateway.simulation.wearer import Wearer
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook

Make = Callable[..., SimulatedPolarVeritySense]
HASTY = Quirks(first_intervals_s=3.0)
"""Who does not test the first half minute need not wait for it."""


@pytest.fixture
def sensor(switch_on: Make) -> Make:
    """Switch a sensor on for the rest of the test."""

    def make(quirks: Quirks = HASTY, **options: Any) -> SimulatedPolarVeritySense:
        wearer = Wearer(seed=5, heart_rate_bpm=100)
        return switch_on(SimulatedPolarVeritySense, quirks=quirks, wearer=wearer, **options)

    return make
