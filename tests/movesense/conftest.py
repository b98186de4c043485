"""Virtual Movesense sensors on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import ExitStack
from typing import Any

import pytest

from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.devices.movesense.simulator import SimulatedMovesense
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook

MakeSensor = Callable[..., SimulatedMovesense]


@pytest.fixture
def sensor(radio: Radio, monkeypatch: pytest.MonkeyPatch) -> Generator[MakeSensor]:
    """Switch a sensor on for the rest of the test; it is looked for without long pauses."""
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(supervisor_module, "BACKOFF_FIRST_S", 0.1)
    wearer = Wearer(seed=5, heart_rate_bpm=100)
    with ExitStack() as stack:

        def make(**options: Any) -> SimulatedMovesense:
            device = SimulatedMovesense(radio.world, radio, wearer=wearer, **options)
            return stack.enter_context(device)

        yield make
