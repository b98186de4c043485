"""Virtual EmotiBits, and packets without one."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import ExitStack
from typing import Any

import pytest

from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.devices.emotibit.driver.protocol import Packet
from biosensor_gateway.devices.emotibit.simulator import SimulatedEmotiBit
from biosensor_gateway.simulation.wearer import Wearer
from biosensor_gateway.simulation.world import World

MakeEmotiBit = Callable[..., SimulatedEmotiBit]


@pytest.fixture
def emotibit(monkeypatch: pytest.MonkeyPatch) -> Generator[MakeEmotiBit]:
    """Switch a device on for the rest of the test; it is looked for without long pauses."""
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(supervisor_module, "BACKOFF_FIRST_S", 0.1)
    wearer = Wearer(seed=5, heart_rate_bpm=100)
    with ExitStack() as stack:
        world = stack.enter_context(World())

        def make(**options: Any) -> SimulatedEmotiBit:
            return stack.enter_context(SimulatedEmotiBit(world, wearer=wearer, **options))

        yield make


def packet(time_ms: int, number: int, tag: str, *payload: str | float) -> Packet:
    """Return a packet as it was read."""
    return Packet(time_ms, number, tag, tuple(map(str, payload)))
