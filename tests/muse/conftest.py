"""Virtual Muse headbands on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest

from biosensor_gateway.devices.muse.simulator import SimulatedAthena, SimulatedMuse
from biosensor_gateway.simulation.wearer import Wearer
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook

Make = Callable[..., SimulatedMuse | SimulatedAthena]


@pytest.fixture(params=[SimulatedMuse, SimulatedAthena], ids=["classic", "athena"])
def kind(request: pytest.FixtureRequest) -> type[SimulatedMuse | SimulatedAthena]:
    """Of which generation a headband is."""
    return request.param


@pytest.fixture
def headband(kind: type[SimulatedMuse | SimulatedAthena], switch_on: Make) -> Make:
    """Switch a headband on for the rest of the test."""
    return partial(switch_on, kind, wearer=Wearer(seed=5, heart_rate_bpm=100))
