"""Joins a device's data and splits it at random places, as byte streams may do."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from operator import attrgetter
from typing import Any

import numpy as np

from biosensor_gateway.simulation.faults import Effect, lasting

# Time for which bytes wait for others; those after a split wait again.
_TOGETHER_S = 0.02
_LONGEST_TAIL = 24


class Glue:
    """Passes bytes on unchanged, or joined and split; must run in the loop's thread.

    Parameters
    ----------
    send
        Accepts all bytes or nothing; returns which.
    """

    def __init__(self, send: Callable[[bytes], bool]) -> None:
        self._send = send
        self._rng = np.random.default_rng(0)
        self._held = bytearray()
        self._is_on = self._is_fresh = False
        self._turn: asyncio.TimerHandle | None = None

    def switch(self, *, on: bool) -> None:
        """Switch joining and splitting on or off."""
        self._is_on = on
        if not on:
            self.flush()

    def write(self, data: bytes) -> bool:
        """Accept all of ``data`` or nothing."""
        if not self._is_on:
            return self._send(data)
        # The first byte is sent now, which shows whether there is room and a listener.
        if not self._held and not self._send(data[:1]):
            return False
        self._held += data if self._held else data[1:]
        self._is_fresh = True
        if self._turn is None:
            self._turn = asyncio.get_running_loop().call_later(_TOGETHER_S, self._take_turn)
        return True

    def flush(self) -> None:
        """Send all waiting bytes."""
        held = bytes(self._held)
        self.forget()
        if held:
            self._send(held)

    def forget(self) -> None:
        """Discard all waiting bytes."""
        self._held.clear()
        if self._turn is not None:
            self._turn.cancel()
            self._turn = None

    def _take_turn(self) -> None:
        self._turn = None
        tail = int(self._rng.integers(_LONGEST_TAIL)) if self._is_fresh else 0
        goes = bytes(self._held[: max(1, len(self._held) - tail)])
        if goes and self._send(goes):
            del self._held[: len(goes)]
        self._is_fresh = False
        if self._held:
            self._turn = asyncio.get_running_loop().call_later(_TOGETHER_S, self._take_turn)


def glued(path: str) -> Effect[Any]:
    """Return the effect of switching a device's `glue` on, if it has a port."""
    port = attrgetter(path)

    def switch(hit: object, *, on: bool) -> None:
        if (found := port(hit)) is not None:
            found.glue(on=on)

    return lasting(lambda hit: switch(hit, on=True), lambda hit: switch(hit, on=False))
