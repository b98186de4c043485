"""A device, and a link to it, on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import pytest

from biosensor_common.errors import GatewayError, TransportReason
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.transports import ble_choice
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_scanner import advertisements
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook
from tests.rigs.probe import Probe, choice, refusal, switched_on


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
    """Wait for others that are not there, or are `heard`, no longer than necessary."""
    monkeypatch.setattr(ble_choice, "OTHERS_S", 0.5)


async def absence(link: BleLink) -> GatewayError:
    """Return the error of looking in vain, but not for long; what is there has all its time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ble_choice, "SCAN_S", 0.5)
        error = await refusal(link.open())
    assert error.reason is TransportReason.ABSENT
    return error


@asynccontextmanager
async def heard(*probes: Probe) -> AsyncGenerator[None]:
    """Keep a scan that has heard them: who looks meanwhile is told of them at once."""
    missing = {probe.address for probe in probes}
    async with advertisements() as scan:
        while missing:
            seen = await anext(scan)
            if seen.name:
                missing.discard(seen.address)
        yield
