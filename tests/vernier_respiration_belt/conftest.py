"""A virtual belt on every Bluetooth rig."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from biosensor_gateway.devices.vernier_respiration_belt.simulator import SimulatedBelt
from biosensor_gateway.devices.vernier_respiration_belt.simulator.wire import BeltFirmware, Command
from tests.rigs.bluetooth import *  # noqa: F403 - its fixtures and its hook


@pytest.fixture
def belt(switch_on: Callable[..., SimulatedBelt]) -> SimulatedBelt:
    """One that is switched on."""
    return switch_on(SimulatedBelt, jitter_s=0.02, warm_up_s=1.0)


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
