"""Tells the time, and lets threads wait by it.

Drivers, streams, supervisors and virtual devices are given one clock. Beside LSL's own, tests
have one that stands still while anybody works, so that half a minute of streaming takes as
long as the work in it.
"""

from __future__ import annotations

import asyncio
import ctypes
from collections.abc import Callable
from concurrent.futures import Future
from typing import Protocol, TypeVar

_T = TypeVar("_T")


class Clock(Protocol):
    """Seconds on LSL's clock when called; the event loops that it makes go by it."""

    def __call__(self) -> float:
        """Return the time now, in seconds on LSL's clock."""
        ...

    def new_event_loop(self) -> asyncio.AbstractEventLoop:
        """Make an event loop whose timers go by this clock, for a thread of its own."""
        ...

    def wait_for(self, future: Future[_T], limit_s: float) -> _T:
        """Block until another thread has the result; raise TimeoutError after `limit_s`."""
        ...


class LslClock:
    """The time that LSL stamps with."""

    def __init__(self) -> None:
        self._now: Callable[[], float] | None = None

    def __call__(self) -> float:
        """Return the time now, in seconds."""
        now = self._now
        if now is None:
            now = self._now = _local_clock()
        return now()

    def new_event_loop(self) -> asyncio.AbstractEventLoop:
        """Make an event loop."""
        return asyncio.new_event_loop()

    def wait_for(self, future: Future[_T], limit_s: float) -> _T:
        """Block until another thread has the result; raise TimeoutError after `limit_s`."""
        return future.result(limit_s)


def _local_clock() -> Callable[[], float]:
    # Only now: settings and help do without LSL.
    from pylsl.lib import lib

    # pylsl's own call lets other threads of Python run meanwhile. This one takes 0.1 us and is
    # asked six times for each sample: to wait for one's turn again costs far more than it gives.
    return ctypes.PYFUNCTYPE(ctypes.c_double)(("lsl_local_clock", lib))


LSL_CLOCK = LslClock()
