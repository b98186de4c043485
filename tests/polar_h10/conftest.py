"""Virtual Polar sensors on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import ExitStack
from typing import Any

import pytest

from biosensor_gateway import supervisor as supervisor_module
from biosensor_gateway.devices.polar_h10.simulator import SimulatedPolarH10
from biosensor_gateway.devices.polar_h10.simulator.quirks import Quirks
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.wearer import Wearer
from tests.rigs.bluetooth import bluetooth, bluez, host_mtu, radio, rig, world

__all__ = ["bluetooth", "bluez", "host_mtu", "radio", "rig", "world"]


@pytest.fixture
def sensor(
    radio: Radio, monkeypatch: pytest.MonkeyPatch
) -> Generator[Callable[..., SimulatedPolarH10]]:
    """Switch a sensor on for the rest of the test; it is looked for without long pauses."""
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(supervisor_module, "BACKOFF_FIRST_S", 0.1)
    with ExitStack() as stack:

        def make(quirks: Quirks | None = None, **options: Any) -> SimulatedPolarH10:
            wearer = Wearer(seed=5, heart_rate_bpm=100)
            twin = SimulatedPolarH10(radio.world, radio, quirks=quirks, wearer=wearer, **options)
            return stack.enter_context(twin)

        yield make
