"""Virtual optical sensors on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import ExitStack
from typing import Any

import pytest

from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.devices.polar_h10.simulator.products import Quirks
from biosensor_gateway.devices.polar_verity_sense.simulator import SimulatedPolarVeritySense
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook

Make = Callable[..., SimulatedPolarVeritySense]
HASTY = Quirks(first_intervals_s=3.0)
"""Who does not test the first half minute need not wait for it."""


@pytest.fixture
def sensor(radio: Radio, monkeypatch: pytest.MonkeyPatch) -> Generator[Make]:
    """Switch a sensor on for the rest of the test; it is found without long pauses."""
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(supervisor_module, "BACKOFF_FIRST_S", 0.1)
    with ExitStack() as stack:

        def make(quirks: Quirks = HASTY, **options: Any) -> SimulatedPolarVeritySense:
            wearer = Wearer(seed=5, heart_rate_bpm=100)
            device = SimulatedPolarVeritySense(
                radio.world, radio, quirks=quirks, wearer=wearer, **options
            )
            return stack.enter_context(device)

        yield make
