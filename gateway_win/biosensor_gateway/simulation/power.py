"""Keeps a device switched off as long as there is any reason for it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from enum import Enum


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
