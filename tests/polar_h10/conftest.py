"""Virtual Polar sensors on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import ExitStack
from functools import partial
from typing import Any

import pytest

from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.devices.polar_h10.simulator.products import Quirks
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from tests.polar_h10.steering import SteeredPolarH10
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook

Make = Callable[..., SteeredPolarH10]


@pytest.fixture
def make_h10(radio: Radio) -> Generator[Make]:
    """Switch a sensor on for the rest of the test."""
    with ExitStack() as stack:

        def make(quirks: Quirks | None = None, **options: Any) -> SteeredPolarH10:
            device = SteeredPolarH10(radio.world, radio, quirks=quirks, **options)
            return stack.enter_context(device)

        yield make


@pytest.fixture
def sensor(make_h10: Make, monkeypatch: pytest.MonkeyPatch) -> Make:
    """Do so for a driver, which looks for it without long pauses."""
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(supervisor_module, "BACKOFF_FIRST_S", 0.1)
    return partial(make_h10, wearer=Wearer(seed=5, heart_rate_bpm=100))
