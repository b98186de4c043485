"""Joins what a device writes, and cuts it anywhere, as what carries a stream of bytes does."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from operator import attrgetter
from typing import Any

import numpy as np

from biosensor_gateway.simulation.effects import Effect, lasting

_TOGETHER_S = 0.02
"""So long bytes wait for others; those behind a cut wait once more."""
_LONGEST_TAIL = 24


class Glue:
    """Hands bytes on at once, or together and cut; for the loop's thread.

    Parameters
    ----------
    send
        Takes all of them or nothing, which it tells.
    """

    def __init__(self, send: Callable[[bytes], bool]) -> None:
        self._send = send
        self._rng = np.random.default_rng(0)
        self._held = bytearray()
        self._is_on = self._is_fresh = False
        self._turn: asyncio.TimerHandle | None = None

    def switch(self, *, on: bool) -> None:
        """Join and cut from now on, or do not."""
        self._is_on = on
        if not on:
            self.flush()

    def write(self, data: bytes) -> bool:
        """Take all of ``data`` or nothing."""
        if not self._is_on:
            return self._send(data)
        # Whether there is room, and anybody who listens, tells what goes now.
        if not self._held and not self._send(data[:1]):
            return False
        self._held += data if self._held else data[1:]
        self._is_fresh = True
        if self._turn is None:
            self._turn = asyncio.get_running_loop().call_later(_TOGETHER_S, self._take_turn)
        return True

    def flush(self) -> None:
        """Send all that waits."""
        held = bytes(self._held)
        self.forget()
        if held:
            self._send(held)

    def forget(self) -> None:
        """Send nothing of what waits."""
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
    """Return the effect that what a device has to write with, if any, joins and cuts."""
    port = attrgetter(path)

    def switch(hit: object, *, on: bool) -> None:
        if (found := port(hit)) is not None:
            found.glue(on=on)

    return lasting(lambda hit: switch(hit, on=True), lambda hit: switch(hit, on=False))
