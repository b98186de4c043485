"""A device, and a link to it, on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import AsyncGenerator

import pytest

from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.transports import ble_choice
from biosensor_gateway.transports.ble import BleLink
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook
from tests.rigs.probe import Probe
from tests.rigs.probe_link import choice, switched_on


@pytest.fixture
def probe(radio: Radio) -> Probe:
    return switched_on(radio, 1)


@pytest.fixture
async def link(probe: Probe) -> AsyncGenerator[BleLink]:
    del probe
    opened = BleLink(choice("1"))
    await opened.open()
    yield opened
    await opened.close()


@pytest.fixture
def hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give up early what a test wants to be given up."""
    monkeypatch.setattr(ble_choice, "SCAN_S", 0.5)
    monkeypatch.setattr(ble_choice, "RIVALS_S", 0.5)
