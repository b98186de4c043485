"""Sends the samples of several streams, each when it is due."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

import numpy as np

from benchmarks.child import Orders, say
from benchmarks.samples import FILLER

T = TypeVar("T")


class Schedule(Generic[T]):
    """Sends for one stream after the other, evenly spread over a period or all at once.

    Every sample has its own due time, so a late one does not delay the next. What is
    sent is made before its time is taken.

    Parameters
    ----------
    make
        Makes what is sent for a number.
    sends
        One for each stream; takes what is sent and the monotonic time at which it was due.
    offset_s
        Delay of the first stream within a period, so that several processes take turns.
    filler
        Number of the samples that are sent while none counts.
    together
        Whether all streams are due at the same time: sleeping costs more than sending.
    """

    def __init__(
        self,
        make: Callable[[float], T],
        sends: Sequence[Callable[[T, float], None]],
        rate_hz: float,
        offset_s: float = 0.0,
        filler: float = FILLER,
        *,
        together: bool = False,
    ) -> None:
        self._make, self._sends = make, sends
        self._period_s, self._filler = 1 / rate_hz, filler
        spread = 0.0 if together else self._period_s
        self._offsets_s = [spread * stream / len(sends) for stream in range(len(sends))]
        # Counted from the clock's zero, so that the phases of several processes fit together.
        self._due = (time.monotonic() // self._period_s + 1) * self._period_s + offset_s

    def run(self, orders: Orders) -> None:
        """Send until the parent closes the pipe.

        The order ``COUNT FILE`` has so many numbered samples sent on each stream, their
        times written, shape [2, streams, count] of sending and of being due, and
        ``sent`` said.
        """
        while not orders.closed.is_set():
            order = orders.poll()
            if order is None:
                self._step(self._filler)
            else:
                count, _, file = order.partition(" ")
                self._send_numbered(int(count), file)
                say("sent")

    def _send_numbered(self, count: int, file: str) -> None:
        times = np.empty((2, count, len(self._sends)))
        for number in range(count):
            times[1, number] = [self._due + offset_s for offset_s in self._offsets_s]
            times[0, number] = self._step(float(number))
        np.save(file, times.transpose(0, 2, 1))

    def _step(self, number: float) -> list[float]:
        """Send one sample on each stream; return when."""
        times: list[float] = []
        for send, offset_s in zip(self._sends, self._offsets_s, strict=True):
            sample = self._make(number)
            due = self._due + offset_s
            time.sleep(max(0.0, due - time.monotonic()))
            times.append(time.monotonic())
            send(sample, due)
        self._due += self._period_s
        return times
