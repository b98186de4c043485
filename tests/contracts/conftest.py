"""Any virtual device by its name, with what it lives in: outside time, but for real links."""

from __future__ import annotations

import sys
from collections.abc import AsyncGenerator, Callable, Generator
from contextlib import contextmanager
from functools import partial
from typing import cast

import pytest

from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.demo.virtual_devices import virtual_class, virtual_names
from biosensor_gateway.devices import registry
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.faults import Kind
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.virtual_device import VirtualDevice
from biosensor_gateway.simulation.world import World
from tests.every_sensor.acme_band import SENSOR as SOMEBODY_ELSES
from tests.rigs.virtual_time import VirtualTime, virtual_time
from tests.tiers.tier import is_in_memory

NAMES = (
    *virtual_names(),
    # Its port is a pseudo-terminal where it is real.
    *([SOMEBODY_ELSES.spec.name] if sys.platform != "win32" else []),
)


@contextmanager
def somebody_elses_sensor() -> Generator[None]:
    """Have a sensor that is none of ours."""
    known = registry.sensor

    def with_theirs(name: str) -> object:
        return SOMEBODY_ELSES if name == SOMEBODY_ELSES.spec.name else known(name)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registry, "sensor", with_theirs)
        yield


def class_of(name: str) -> type[VirtualDevice]:
    """Return the class of a virtual device, also of somebody else's."""
    if name == SOMEBODY_ELSES.spec.name:
        from tests.every_sensor.acme_band.simulator import (  # noqa: PLC0415 - POSIX alone has it
            SimulatedAcmeBand,
        )

        return SimulatedAcmeBand
    return virtual_class(name)


def is_recording(name: str) -> bool:
    """Tell whether it plays what a real device sent, of which nobody knows the truth."""
    return name.endswith(":recording")


ON_AIR = pytest.mark.parametrize(
    "name", [each for each in NAMES if class_of(each).on_air], indirect=True
)
"""For what only Bluetooth LE does."""


def every(*kinds: Kind) -> pytest.MarkDecorator:
    """Run a test for each device and each fault of these that it can have."""
    cells = [(name, kind) for name in NAMES for kind in kinds if kind in class_of(name).effects]
    labels = [f"{name}-{kind.value}" for name, kind in cells]
    return pytest.mark.parametrize(("name", "kind"), cells, indirect=["name"], ids=labels)


Make = Callable[..., VirtualDevice]


@pytest.fixture(params=NAMES)
def name(request: pytest.FixtureRequest) -> Generator[str]:
    with somebody_elses_sensor():
        yield request.param


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave out, over real links, devices that have none, and what needs no device."""
    items[:] = [
        item for item in items if "test_on_real_links" not in item.nodeid or _has_link(item)
    ]


def _has_link(item: pytest.Item) -> bool:
    assert isinstance(item, pytest.Function)
    name = cast("str", item.callspec.params["name"])
    return "world" in item.fixturenames and not class_of(name).on_air


@pytest.fixture
async def world(name: str, request: pytest.FixtureRequest) -> AsyncGenerator[World]:
    """Outside time, unless bytes go by real links."""
    if class_of(name).on_air or is_in_memory(request.node):
        with virtual_time() as clock, World(clock) as world:
            yield world
    else:
        with World() as world:
            yield world


def is_outside_time(device: VirtualDevice) -> bool:
    """Tell whether what it does takes as long on any computer."""
    return isinstance(device.world.clock, VirtualTime)


@pytest.fixture
def radio(name: str, world: World) -> Generator[Radio | None]:
    """The air, for whom it is there."""
    if not class_of(name).on_air:
        yield None
        return
    air = Radio(world)
    with virtual_bluetooth(air):
        yield air


@pytest.fixture
def make(name: str, world: World, radio: Radio | None, monkeypatch: pytest.MonkeyPatch) -> Make:
    """Make devices of a kind, which are found without long pauses."""
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(supervisor_module, "BACKOFF_FIRST_S", 0.1)
    place = (world,) if radio is None else (world, radio)
    return partial(cast("Make", class_of(name)), *place)


@pytest.fixture
def device(make: Make, monkeypatch: pytest.MonkeyPatch) -> Generator[VirtualDevice]:
    """One that is switched on, with what a driver needs of the environment."""
    with make() as device:
        for variable, text in device.environment.items():
            monkeypatch.setenv(variable, text)
        yield device
