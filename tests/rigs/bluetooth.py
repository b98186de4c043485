"""Bluetooth LE on two rigs, as fixtures for a conftest to import.

On ``bumble``, bleak has a backend of ours over the virtual radio. On ``bluez`` it is
bleak's own Linux backend, which talks D-Bus to a fake BlueZ on the same radio. A test
that uses `radio` runs on both, each night; the marks say why one would not.
"""

from __future__ import annotations

import asyncio
import shutil
import sys
from collections.abc import AsyncGenerator, Callable, Generator
from contextlib import ExitStack, asynccontextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

from biosensor_gateway.agent import supervisor
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.radio import MAX_MTU, Radio
from biosensor_gateway.simulation.world import World
from biosensor_gateway.system.clock import LSL_CLOCK, Clock
from tests.rigs.polling import until
from tests.rigs.virtual_time import virtual_clock, virtual_time

if TYPE_CHECKING:
    from tests.rigs.bluez import FakeBluez

__all__ = [
    "bluetooth",
    "bluez",
    "clock",
    "hasty",
    "host_mtu",
    "radio",
    "rig",
    "switch_on",
    "virtual_clock",
    "virtual_world",
    "world",
]

_BLUEZ = pytest.param("bluez", marks=pytest.mark.nightly)
ON_BLUEZ = pytest.mark.parametrize("rig", [_BLUEZ])
"""For what only BlueZ does."""
SEAM_ON_BLUEZ = pytest.mark.parametrize("rig", [pytest.param("bluez", marks=pytest.mark.seam)])
"""The same for the few tests that every change has to pass."""
ON_BUMBLE = pytest.mark.parametrize("rig", ["bumble"])
"""For what BlueZ does otherwise, and for bleak calls that the test replaces on any rig."""


class Bluetooth(NamedTuple):
    """What a computer's Bluetooth is made of; no BlueZ where the rig is ours alone."""

    radio: Radio
    bluez: FakeBluez | None = None


@pytest.fixture(params=["bumble", _BLUEZ])
def rig(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture
def host_mtu() -> int:
    """The ATT MTU that the computer asks for; a test may say another one."""
    return MAX_MTU


@pytest.fixture
async def clock(rig: str) -> AsyncGenerator[Clock]:
    """LSL's time where D-Bus is, else one that stands still while anybody works."""
    if rig == "bluez":
        yield LSL_CLOCK
    else:
        with virtual_time() as clock:
            yield clock


@pytest.fixture
def world(clock: Clock) -> Generator[World]:
    with World(clock) as world:
        yield world


@pytest.fixture
async def virtual_world() -> AsyncGenerator[World]:
    """A world for tests that need no rig."""
    with virtual_time() as clock, World(clock) as world:
        yield world


@pytest.fixture
async def bluetooth(
    rig: str, host_mtu: int, world: World, monkeypatch: pytest.MonkeyPatch
) -> AsyncGenerator[Bluetooth]:
    """Have bleak use the rig."""
    radio = Radio(world, host_mtu=host_mtu)
    if rig == "bumble":
        with virtual_bluetooth(radio):
            yield Bluetooth(radio)
    else:
        async with _fake_bluez(radio, monkeypatch) as bluez:
            yield Bluetooth(radio, bluez)


@pytest.fixture
def radio(bluetooth: Bluetooth) -> Radio:
    return bluetooth.radio


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look for devices without long pauses."""
    monkeypatch.setattr(supervisor, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(supervisor, "BACKOFF_FIRST_S", 0.1)


@pytest.fixture
def switch_on(radio: Radio, hasty: None) -> Generator[Callable[..., Any]]:
    """Switch a device of a class on for the rest of the test; it is found without long pauses."""
    del hasty
    with ExitStack() as stack:

        def make(kind: Callable[..., Any], **options: Any) -> Any:
            return stack.enter_context(kind(radio.world, radio, **options))

        yield make


@pytest.fixture
def bluez(bluetooth: Bluetooth) -> FakeBluez:
    """The service itself; for tests marked `ON_BLUEZ`."""
    assert bluetooth.bluez
    return bluetooth.bluez


@asynccontextmanager
async def _fake_bluez(radio: Radio, monkeypatch: pytest.MonkeyPatch) -> AsyncGenerator[FakeBluez]:
    if sys.platform != "linux" or not shutil.which("dbus-daemon"):
        pytest.skip("a Linux with dbus-daemon is needed")
    # D-Bus libraries are there on Linux only.
    from bleak.backends.bluezdbus.version import BlueZFeatures  # noqa: PLC0415 - see above

    from tests.rigs.bluez import FakeBluez  # noqa: PLC0415 - see above

    with FakeBluez(radio) as bluez:
        for name, value in bluez.environment.items():
            monkeypatch.setenv(name, value)
        # bleak asks once a process, and waits for ever if who asked first was cancelled.
        await BlueZFeatures.check_bluez_version()
        yield bluez
        bluez.kill_bus()
        # bleak has one manager an event loop; it ends with its bus, and so do pending calls.
        await until(lambda: len(asyncio.all_tasks()) == 1)
