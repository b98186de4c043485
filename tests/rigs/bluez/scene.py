"""Virtual devices that bleak's own Linux backend finds, in any process."""

from __future__ import annotations

from contextlib import ExitStack
from functools import cached_property

from biosensor_gateway.demo.virtual_devices import Scene
from biosensor_gateway.simulation.radio import Radio
from tests.rigs.bluez.adapter import FakeBluez


class BluezScene(Scene):
    """A scene whose air is heard by a fake BlueZ, which there is from the first use on."""

    def __init__(self, stack: ExitStack) -> None:
        super().__init__(stack)
        self._bluez_stack = stack
        self.bluez: FakeBluez | None = None

    @cached_property
    def radio(self) -> Radio:
        """The air."""
        radio = Radio(self.world)
        self.bluez = self._bluez_stack.enter_context(FakeBluez(radio))
        return radio
