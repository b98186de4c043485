"""A virtual belt on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Generator

import pytest

from biosensor_gateway.agent import supervisor as supervisor_module
from biosensor_gateway.devices.vernier_respiration_belt.simulator import SimulatedBelt
from biosensor_gateway.devices.vernier_respiration_belt.simulator.wire import BeltFirmware, Command
from biosensor_gateway.simulation.radio import Radio
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look for belts without long pauses."""
    monkeypatch.setattr(supervisor_module, "PROBE_INTERVAL_S", 0.05)
    monkeypatch.setattr(supervisor_module, "BACKOFF_FIRST_S", 0.1)


@pytest.fixture
def belt(radio: Radio, hasty: None) -> Generator[SimulatedBelt]:
    """One that is switched on."""
    del hasty
    with SimulatedBelt(radio.world, radio, jitter_s=0.02, warm_up_s=1.0) as belt:
        yield belt


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[Command]:
    """What the belt was told; each is short enough to come in one piece."""
    told: list[Command] = []
    hear = BeltFirmware.hear

    def noted(self: BeltFirmware, fragment: bytes) -> list[bytes]:
        if fragment[4] in (Command.START, Command.STOP, Command.DISCONNECT):
            told.append(Command(fragment[4]))
        return hear(self, fragment)

    monkeypatch.setattr(BeltFirmware, "hear", noted)
    return told
