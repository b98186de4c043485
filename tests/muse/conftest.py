"""Virtual Muse headbands on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import ExitStack
from typing import Any

import pytest

from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.devices.muse.simulator import SimulatedAthena, SimulatedMuse
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook

Make = Callable[..., SimulatedMuse | SimulatedAthena]


@pytest.fixture(params=[SimulatedMuse, SimulatedAthena], ids=["classic", "athena"])
def kind(request: pytest.FixtureRequest) -> type[SimulatedMuse | SimulatedAthena]:
    """Of which generation a headband is."""
    return request.param


@pytest.fixture
def headband(
    kind: type[SimulatedMuse | SimulatedAthena],
    radio: Radio,
    monkeypatch: pytest.MonkeyPatch,
) -> Generator[Make]:
    """Switch a headband on for the rest of the test; it is looked for without long pauses."""
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(supervisor_module, "BACKOFF_FIRST_S", 0.1)
    wearer = Wearer(seed=5, heart_rate_bpm=100)
    with ExitStack() as stack:

        def make(**options: Any) -> SimulatedMuse | SimulatedAthena:
            return stack.enter_context(kind(radio.world, radio, wearer=wearer, **options))

        yield make
