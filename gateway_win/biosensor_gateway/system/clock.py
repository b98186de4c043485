"""Clocks: LSL's, and a virtual one that advances only while everybody waits.

Drivers, streams, supervisors and virtual devices share one clock. With the virtual clock, half a
minute of streaming takes only as long as its computations. This module has one for a single event
loop; the tests have one for many threads.
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
    """A clock: returns seconds on LSL's clock, and makes event loops whose timers use it."""

    def __call__(self) -> float:
        """Return the time now, in seconds on LSL's clock."""
        ...

    def new_event_loop(self) -> asyncio.AbstractEventLoop:
        """Make an event loop whose timers use this clock, for a separate thread."""
        ...

    def wait_for(self, future: Future[_T], limit_s: float) -> _T:
        """Block until another thread has the result; raise TimeoutError after `limit_s`."""
        ...


class LslClock:
    """The clock with which LSL stamps samples."""

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
    """A virtual clock: stands still while its event loop works, and leaps to its next timer.

    For a loop without sockets or other threads, whose events would arrive too late.
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
    """Advances the clock instead of waiting."""

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
    # Imported here, because settings and help do not need LSL.
    from pylsl.lib import lib

    # pylsl's own call releases the GIL. The function takes 0.1 us and is called six times for each
    # sample, so that taking the GIL again would cost far more than it gives other threads.
    return ctypes.PYFUNCTYPE(ctypes.c_double)(("lsl_local_clock", lib))


LSL_CLOCK = LslClock()
