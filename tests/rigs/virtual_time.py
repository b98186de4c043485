"""A clock that stands still while anybody works, for a test and the worlds of its devices.

Threads take turns: only when all of them wait, time moves on to whatever comes first. So half
a minute of streaming takes as long as the work in it, and is the same each time. A job of
:func:`asyncio.to_thread` takes no turn, but holds the time until it is done. It holds for
what is in this process alone: nobody can tell a socket, a terminal or a bus to wait.
"""

from __future__ import annotations

import asyncio
import math
import selectors
import threading
from collections.abc import AsyncGenerator, Callable, Generator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from contextvars import Context
from time import monotonic
from typing import NamedTuple, TypeVar, TypeVarTuple

import pytest
from pylsl import local_clock

from tests.tiers.guard import GUARD

_T = TypeVar("_T")
_Ts = TypeVarTuple("_Ts")
# Somebody who takes no turns, such as a thread of a library, may have what all wait for.
_OUTSIDE_S = 0.001


class _Wait(NamedTuple):
    until_s: float
    is_over: Callable[[], bool]


class VirtualTime:
    """A :class:`~biosensor_gateway.system.clock.Clock`; to be made in the test's thread."""

    def __init__(self) -> None:
        self._now_s = local_clock()
        self._changed = threading.Condition()
        self._waits: dict[int, _Wait] = {}
        self._at_work: int | None = threading.get_ident()
        # By job, the thread that does it, once one does.
        self._jobs: dict[object, int | None] = {}

    def __call__(self) -> float:
        """Return the time now, in seconds."""
        return self._now_s

    def new_event_loop(self) -> asyncio.AbstractEventLoop:
        """Make an event loop for a thread that takes turns until the loop stops."""
        return _WorldLoop(self)

    def wait_for(self, future: Future[_T], limit_s: float) -> _T:
        """Let the others work until one of them has the result."""
        # The limit is one of patience, in the system's time: the others may be slow, not late.
        give_up_s = monotonic() + limit_s
        self.wait(math.inf, lambda: future.done() or monotonic() > give_up_s)
        return future.result(0.0)

    def wait(self, until_s: float, is_over: Callable[[], bool]) -> None:
        """Let the others work until a time, or until something is so."""
        me = threading.get_ident()
        with self._changed:
            self._waits[me] = _Wait(until_s, is_over)
            self._pass_on(me)
            while self._at_work != me:
                with GUARD.allowance():
                    has_changed = self._changed.wait(_OUTSIDE_S)
                if not has_changed:
                    self._choose()
            del self._waits[me]

    def come_in(self, job: object) -> None:
        """Take turns from now on; time is not held for the job any more."""
        self.wait(-math.inf, lambda: True)
        self.done(job)

    def leave(self) -> None:
        """Take no turns any more."""
        with self._changed:
            self._pass_on(threading.get_ident())

    def hold(self, job: object) -> None:
        """Keep the time from moving on until the job is done, or its thread waits."""
        with self._changed:
            self._jobs[job] = None

    def begin(self, job: object) -> None:
        """Say that this thread does the job."""
        with self._changed:
            if job in self._jobs:
                self._jobs[job] = threading.get_ident()

    def done(self, job: object) -> None:
        """Let the time go."""
        with self._changed:
            self._jobs.pop(job, None)

    def _pass_on(self, me: int) -> None:
        # Who comes in has no turn to pass on.
        if self._at_work == me:
            self._at_work = None
        self._choose()

    def _choose(self) -> None:
        if self._at_work is not None or not self._waits:
            return
        ready = (one for one, wait in self._waits.items() if wait.is_over())
        self._at_work = next(ready, None)
        if self._at_work is None:
            first = min(self._waits, key=lambda one: self._waits[one].until_s)
            until_s = self._waits[first].until_s
            if math.isinf(until_s) or any(one not in self._waits for one in self._jobs.values()):
                return
            self._now_s = max(self._now_s, until_s)
            self._at_work = first
        self._changed.notify_all()


class _Selector(selectors.DefaultSelector):
    """Waits by a clock, if it has one."""

    def __init__(self) -> None:
        super().__init__()
        self.clock: VirtualTime | None = None

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Return what is ready."""
        if self.clock is None:
            return super().select(timeout)
        found = super().select(0)
        if found or (timeout is not None and timeout <= 0):
            return found
        until_s = math.inf if timeout is None else self.clock() + timeout
        self.clock.wait(until_s, lambda: bool(super(_Selector, self).select(0)))
        return super().select(0)


class SwitchableLoop(asyncio.SelectorEventLoop):
    """An event loop that goes by the system's time until it is given another."""

    def __init__(self) -> None:
        self._waiting = _Selector()
        super().__init__(self._waiting)

    def time(self) -> float:
        """Return the time now, in seconds."""
        clock = self._waiting.clock
        return super().time() if clock is None else clock()

    @property
    def clock(self) -> VirtualTime | None:
        """The clock it goes by; None for the system's."""
        return self._waiting.clock

    def switch(self, clock: VirtualTime | None) -> None:
        """Go by a clock from now on; None for the system's."""
        self._waiting.clock = clock

    def run_in_executor(
        self, executor: Executor | None, func: Callable[[*_Ts], _T], *args: *_Ts
    ) -> asyncio.Future[_T]:
        """Run a job in another thread; time waits for it."""
        clock = self._waiting.clock
        if clock is None:
            return super().run_in_executor(executor, func, *args)
        job = object()

        def work() -> _T:
            clock.begin(job)
            try:
                return func(*args)
            finally:
                clock.leave()

        clock.hold(job)
        result = super().run_in_executor(executor, work)
        result.add_done_callback(lambda _: clock.done(job))
        return result


class _WorldLoop(SwitchableLoop):
    def __init__(self, clock: VirtualTime) -> None:
        super().__init__()
        self._clock = clock
        self._has_come = False
        self.switch(clock)

    def call_soon_threadsafe(
        self,
        callback: Callable[[*_Ts], object],
        *args: *_Ts,
        context: Context | None = None,
    ) -> asyncio.Handle:
        """Ask for a call; time waits for a thread that has not come yet."""
        if not self._has_come:
            self._clock.hold(self)
        return super().call_soon_threadsafe(callback, *args, context=context)

    def run_forever(self) -> None:
        """Run until stopped."""
        self._has_come = True
        self._clock.come_in(self)
        try:
            super().run_forever()
        finally:
            self._clock.leave()


@contextmanager
def virtual_time() -> Generator[VirtualTime]:
    """Let the running loop, a :class:`SwitchableLoop`, go by a virtual clock meanwhile."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, SwitchableLoop)
    if loop.clock is not None:
        yield loop.clock
        return
    clock = VirtualTime()
    loop.switch(clock)
    yield clock
    loop.switch(None)


@pytest.fixture
async def virtual_clock() -> AsyncGenerator[VirtualTime]:
    """Let a test go by a clock of its own; for folders whose loops can be switched."""
    with virtual_time() as clock:
        yield clock


def virtual_loop() -> SwitchableLoop:
    """Make a loop that goes by a virtual clock from its beginning."""
    loop = SwitchableLoop()
    loop.switch(VirtualTime())
    return loop
