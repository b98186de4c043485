"""Base class of virtual Bluetooth LE devices: power, tasks, oscillator, radio faults."""

from __future__ import annotations

import asyncio
from abc import abstractmethod
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from enum import Enum
from types import MappingProxyType
from typing import Any, ClassVar, Unpack

import numpy as np
from bumble.gatt import Service

from biosensor_gateway.simulation.faults import (
    Effect,
    Effects,
    FaultKind,
    Untidiness,
    flag,
    lasting,
    level,
    on_part,
    restart,
)
from biosensor_gateway.simulation.peripheral import Peripheral
from biosensor_gateway.simulation.virtual_device import SpecimenOptions, VirtualDevice
from biosensor_gateway.simulation.world import Oscillator, World


class PowerSwitch:
    """Keeps a device on while it is wanted and nothing holds it off.

    Must run in one loop's thread; its callbacks never overlap.

    Parameters
    ----------
    switch_on, switch_off
        Callbacks that switch the device.
    """

    def __init__(
        self, switch_on: Callable[[], Awaitable[None]], switch_off: Callable[[], Awaitable[None]]
    ) -> None:
        self._switch_on = switch_on
        self._switch_off = switch_off
        self._wanted = False
        self._held_off_by: set[Enum] = set()
        self._is_on = False
        self._busy = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    async def want(self, wanted: bool) -> None:
        """Request the device on or off, and wait until it is."""
        self._wanted = wanted
        await self._settle()

    def hold_off(self, reason: Enum) -> None:
        """Switch the device off soon, until `release`."""
        self._held_off_by.add(reason)
        self._settle_soon()

    def release(self, reason: Enum) -> None:
        """Switch the device on again soon, unless there is another reason."""
        self._held_off_by.discard(reason)
        self._settle_soon()

    def _settle_soon(self) -> None:
        task = asyncio.create_task(self._settle())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _settle(self) -> None:
        async with self._busy:
            due = self._wanted and not self._held_off_by
            if due != self._is_on:
                self._is_on = due
                await (self._switch_on() if due else self._switch_off())


# Start of a resolvable private address (two highest bits): Core 5.4 Vol 6 Part B, 1.3.2.2.
_CHANGING = "5E"
RADIO_EFFECTS: Effects[Peripheral] = MappingProxyType(
    {
        FaultKind.DROP: lasting(Peripheral.drop, Peripheral.restore),
        FaultKind.STALL: flag("stalled"),
        Untidiness.BUNDLED: Effect(
            lambda hit, seconds: hit.bundles.wait(seconds), lambda hit: hit.bundles.wait(0.0)
        ),
        Untidiness.NAMELESS: lasting(
            lambda hit: hit.set_nameless(True), lambda hit: hit.set_nameless(False)
        ),
        Untidiness.READDRESSED: lasting(
            lambda hit: hit.set_address(_CHANGING + hit.address[2:]),
            lambda hit: hit.set_address(hit.address),
        ),
    }
)


class RadioDevice(VirtualDevice):
    """A device with a radio that measures for a connected host."""

    def __init__(
        self, world: World, peripheral: Peripheral, **specimen: Unpack[SpecimenOptions]
    ) -> None:
        super().__init__(world, **specimen)
        self._peripheral = peripheral
        self._rng = np.random.default_rng(self.specimen.seed)
        self._drift_ppm = self.specimen.drift_ppm
        self._oscillator = Oscillator(world.clock, self._drift_ppm)
        self._answer_delay_s = 0.0
        self._power = PowerSwitch(self._power_on, self._power_off)
        self._tasks: set[asyncio.Task[None]] = set()
        peripheral.on_connected.append(self._note_signal)
        peripheral.on_disconnected.append(self._lose_host)

    @abstractmethod
    def _services(self) -> Sequence[Service]:
        """Return its GATT services."""

    @abstractmethod
    def _halt(self) -> None:
        """Stop measuring silently."""

    @abstractmethod
    async def _send_garbage(self, amount: int) -> None:
        """Send invalid data."""

    async def _start(self) -> None:
        await self._power.want(True)

    async def _stop(self) -> None:
        await self._power.want(False)

    async def _power_on(self) -> None:
        self._oscillator = Oscillator(self.world.clock, self._drift_ppm)
        await self._peripheral.power_on(self._services())

    async def _power_off(self) -> None:
        self._lose_host()
        await self._peripheral.power_off()

    def _lose_host(self) -> None:
        self._halt()
        for task in self._tasks:
            task.cancel()

    def _run(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        """Run a coroutine in the background while the host is connected."""
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def _note_signal(self) -> None:
        self.truth.sent("rssi", [self.world.clock()], [(self._peripheral.rssi_dbm,)])

    def break_link(self) -> None:
        """Break the link; it is connectable again at once."""
        self._peripheral.drop()
        self._peripheral.restore()

    def _babble(self, amount: float) -> None:
        self._run(self._send_garbage(round(amount)))

    def _forget(self, _: float) -> None:
        self._halt()

    def _drift(self, ppm: float) -> None:
        self._drift_ppm = ppm
        self._oscillator.set_drift(ppm)

    effects: ClassVar[Effects[Any]] = MappingProxyType(
        {
            **on_part("_peripheral", RADIO_EFFECTS),
            FaultKind.GARBAGE: Effect(_babble),
            FaultKind.LATE: level("_answer_delay_s", 0.0, then=break_link),
            FaultKind.FORGET: Effect(_forget),
            FaultKind.RESTART: restart("_power"),
            FaultKind.DRIFT: Effect(_drift),
        }
    )
