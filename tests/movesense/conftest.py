"""Virtual Movesense sensors on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest

from biosensor_gateway.devices.movesense.simulator import SimulatedMovesense
from biosensor_gateway.simulation.wearer import Wearer
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook

MakeSensor = Callable[..., SimulatedMovesense]


@pytest.fixture
def sensor(switch_on: MakeSensor) -> MakeSensor:
    """Switch a sensor on for the rest of the test."""
    return partial(switch_on, SimulatedMovesense, wearer=Wearer(seed=5, heart_rate_bpm=100))
