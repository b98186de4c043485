"""Datagrams on their way through the Wi-Fi, which delays them and keeps their order."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from biosensor_gateway.devices.emotibit.simulator.host import Host
from biosensor_gateway.devices.emotibit.simulator.rounds import Measured
from biosensor_gateway.system.clock import Clock


class OnItsWay(NamedTuple):
    """A datagram, to whom, and the samples in it."""

    host: Host
    datagram: bytes
    samples: Sequence[Measured]


class Sending:
    """Puts datagrams out after a delay, none before one that was sent earlier.

    Parameters
    ----------
    clock
        Of the world.
    rng, jitter_s
        Makes delays, from 0 to the longest.
    put_out
        Called when one is through.
    """

    def __init__(
        self,
        clock: Clock,
        rng: np.random.Generator,
        jitter_s: float,
        put_out: Callable[[OnItsWay], None],
    ) -> None:
        self._clock, self._rng, self._jitter_s = clock, rng, jitter_s
        self._put_out = put_out
        self._pending: set[asyncio.TimerHandle] = set()
        self._waiting: deque[OnItsWay] = deque()
        self._until_s = 0.0

    def send(self, host: Host, datagram: bytes, samples: Sequence[Measured]) -> None:
        """Put one on its way."""
        delay_s = self._jitter_s * float(self._rng.random())
        self._until_s = max(self._until_s, self._clock() + delay_s)

        def arrive() -> None:
            self._pending.discard(timer)
            # Timers of the same moment come in any order.
            self._put_out(self._waiting.popleft())

        self._waiting.append(OnItsWay(host, datagram, samples))
        loop = asyncio.get_running_loop()
        timer = loop.call_later(max(0.0, self._until_s - self._clock()), arrive)
        self._pending.add(timer)

    def forget(self) -> None:
        """Drop what is on its way."""
        for timer in self._pending:
            timer.cancel()
        self._pending.clear()
        self._waiting.clear()
        self._until_s = 0.0
