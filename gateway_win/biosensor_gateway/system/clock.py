"""Tells the time, and lets threads wait by it.

Drivers, streams, supervisors and virtual devices are given one clock. Beside LSL's own, there is
one that stands still while anybody works, so that half a minute of streaming takes as long as the
work in it: here for one event loop, in tests for many threads.
"""

from __future__ import annotations

import asyncio
import ctypes
import selectors
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


class LeapingClock:
    """Stands still while its event loop works, and leaps to whatever that waits for next.

    For a loop alone in its thread: nothing of the world outside comes in time.
    """

    def __init__(self, now_s: float = 0.0) -> None:
        self.now_s = now_s

    def __call__(self) -> float:
        """Return the time now, in seconds."""
        return self.now_s

    def new_event_loop(self) -> asyncio.AbstractEventLoop:
        """Make an event loop."""
        return _LeapingLoop(self)

    def wait_for(self, future: Future[_T], limit_s: float) -> _T:
        """Block until another thread has the result; raise TimeoutError after `limit_s`."""
        return future.result(limit_s)


class _LeapingSelector(selectors.DefaultSelector):
    """Lets the time pass instead of waiting for it."""

    def __init__(self, clock: LeapingClock) -> None:
        super().__init__()
        self._clock = clock

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Return what is ready."""
        found = super().select(timeout if timeout is None else 0)
        if not found and timeout is not None and timeout > 0:
            self._clock.now_s += timeout
        return found


class _LeapingLoop(asyncio.SelectorEventLoop):
    def __init__(self, clock: LeapingClock) -> None:
        self._leaping = clock
        super().__init__(_LeapingSelector(clock))

    def time(self) -> float:
        """Return the time now, in seconds."""
        return self._leaping()


def _local_clock() -> Callable[[], float]:
    # Only now: settings and help do without LSL.
    from pylsl.lib import lib

    # pylsl's own call lets other threads of Python run meanwhile. This one takes 0.1 us and is
    # asked six times for each sample: to wait for one's turn again costs far more than it gives.
    return ctypes.PYFUNCTYPE(ctypes.c_double)(("lsl_local_clock", lib))


LSL_CLOCK = LslClock()
