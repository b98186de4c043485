"""A virtual radio in the place of the machine's own, and a device on it."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterator

import pytest

from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.world import World
from tests.rigs.probe import Probe
from tests.rigs.virtual_time import virtual_clock, virtual_time

__all__ = ["virtual_clock"]


@pytest.fixture
async def world() -> AsyncGenerator[World]:
    with virtual_time() as clock, World(clock) as world:
        yield world


@pytest.fixture
def radio(world: World) -> Iterator[Radio]:
    radio = Radio(world)
    with virtual_bluetooth(radio):
        yield radio


@pytest.fixture
def probe(radio: Radio) -> Probe:
    probe = Probe(radio, "A0:9E:1A:00:00:01", "Probe 1", rssi_dbm=-61)
    probe.power_on()
    return probe
