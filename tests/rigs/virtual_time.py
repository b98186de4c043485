"""A clock that stands still while anybody works, for a test and the worlds of its devices.

Threads take turns: only when all of them wait, time moves on to whatever comes first. So half
a minute of streaming takes as long as the work in it, and is the same each time. A job of
:func:`asyncio.to_thread` takes no turn, but holds the time until it is done. It holds for
what is in this process alone: nobody can tell a socket, a terminal or a bus to wait. Those of
unit tests are in memory (memory_sockets.py, memory_links.py).
"""

# pyright: reportPrivateUsage=false
from __future__ import annotations

import asyncio
import math
import selectors
import socket
import threading
import time
from collections.abc import AsyncGenerator, Callable, Generator, Mapping
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from contextvars import Context
from typing import Any, NamedTuple, TypeVar, TypeVarTuple

import pytest
from pylsl import local_clock

from biosensor_common.nonblocking_writer import NonblockingWriter
from biosensor_gateway.system import logs
from biosensor_gateway.system.clock import LslClock
from tests.rigs.memory_sockets import FIRST_NUMBER, ready, sockets_in_memory
from tests.tiers.guard import GUARD

_T = TypeVar("_T")
_Ts = TypeVarTuple("_Ts")
# Somebody who takes no turns, such as a thread of a library, may have what all wait for.
_OUTSIDE_S = 0.001
_MOMENT_S = 1e-9


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
        give_up_s = time.monotonic() + limit_s
        self.wait(math.inf, lambda: future.done() or time.monotonic() > give_up_s)
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

    def wait_in_turn(self, limit_s: float | None, is_over: Callable[[], bool]) -> bool:
        """Let the others work until something is so; return False where the time is over first.

        For a call that blocks, in whatever thread: one that takes no turns takes none afterwards.
        """
        takes_turns = self._at_work == threading.get_ident()
        self.wait(math.inf if limit_s is None else self._now_s + limit_s, is_over)
        is_so = is_over()
        if not takes_turns:
            self.leave()
        return is_so

    def pass_a_moment(self) -> None:
        """Let work take some time: what is due "now", but for a rounding, would never be."""
        self._now_s += _MOMENT_S

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
    """Waits by a clock, if it has one; also for sockets in memory."""

    def __init__(self) -> None:
        super().__init__()
        self.clock: VirtualTime | None = None
        self._in_memory: dict[int, selectors.SelectorKey] = {}

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Return what is ready."""
        if self.clock is None:
            return super().select(timeout)
        found = self._ready()
        if found or (timeout is not None and timeout <= 0):
            self.clock.pass_a_moment()
            return found
        until_s = math.inf if timeout is None else self.clock() + timeout
        self.clock.wait(until_s, lambda: bool(self._ready()))
        return self._ready()

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        """Watch a file."""
        number = _number_of(fileobj)
        if number < FIRST_NUMBER:
            return super().register(fileobj, events, data)
        if number in self._in_memory:
            raise KeyError(f"{fileobj!r} is registered already")
        key = self._in_memory[number] = selectors.SelectorKey(fileobj, number, events, data)
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        """Watch a file no longer."""
        number = _number_of(fileobj)
        if number < FIRST_NUMBER:
            return super().unregister(fileobj)
        return self._in_memory.pop(number)

    def modify(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        """Watch a file for other events."""
        if _number_of(fileobj) < FIRST_NUMBER:
            return super().modify(fileobj, events, data)
        self.unregister(fileobj)
        return self.register(fileobj, events, data)

    def get_key(self, fileobj: Any) -> selectors.SelectorKey:
        """Return what a file is watched for."""
        return self.get_map()[_number_of(fileobj)]

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        """Return what all files are watched for, by their numbers."""
        of_the_system = super().get_map() or {}
        return {**of_the_system, **self._in_memory} if self._in_memory else of_the_system

    def _ready(self) -> list[tuple[selectors.SelectorKey, int]]:
        found = super().select(0)
        for number, key in tuple(self._in_memory.items()):
            if events := ready(number, key.events):
                found.append((key, events))
        return found


def _number_of(fileobj: Any) -> int:
    return fileobj if isinstance(fileobj, int) else fileobj.fileno()


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

    async def getaddrinfo(self, *arguments: Any, **named: Any) -> Any:
        """Return addresses; those in memory are known at once."""
        if self._waiting.clock is None:
            return await super().getaddrinfo(*arguments, **named)
        return socket.getaddrinfo(*arguments, **named)

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


class _ClockOfTheTest:
    """One clock for all loops, worlds and sockets of a test; made in its thread when asked for."""

    def __init__(self) -> None:
        self._clock: VirtualTime | None = None
        self.is_on = False

    def __call__(self) -> VirtualTime:
        """Return it."""
        if self._clock is None:
            self._clock = VirtualTime()
        return self._clock

    @contextmanager
    def everywhere(self) -> Generator[None]:
        """Let all that goes by LSL's clock go by this one, and keep sockets in memory."""

        def now_s(_: LslClock) -> float:
            return self()()

        def new_event_loop(_: LslClock) -> asyncio.AbstractEventLoop:
            return self().new_event_loop()

        def wait_for(_: LslClock, future: Future[Any], limit_s: float) -> object:
            return self().wait_for(future, limit_s)

        self._clock, self.is_on = None, True
        with sockets_in_memory(self), pytest.MonkeyPatch.context() as patch:
            patch.setattr(LslClock, "__call__", now_s)
            patch.setattr(LslClock, "new_event_loop", new_event_loop)
            patch.setattr(LslClock, "wait_for", wait_for)
            yield
        self._clock, self.is_on = None, False

    def pause(self, seconds: float) -> None:
        """Sleep by the clock of the test; by the system's where the test is real."""
        if self.is_on:
            self().wait_in_turn(seconds, lambda: False)
        else:
            time.sleep(seconds)


clock_of_the_test = _ClockOfTheTest()
"""The clock of the unit test that runs."""
pause = clock_of_the_test.pause


def loop_of_the_test() -> SwitchableLoop:
    """Make a loop; that of a unit test goes by its virtual clock from its beginning."""
    loop = SwitchableLoop()
    if clock_of_the_test.is_on:
        loop.switch(clock_of_the_test())
    return loop


# The limits of the product are for outputs that hang. In a unit test a thread writes to memory or
# to a file and is done some time, however busy the computer is; the test's limit finds a hang.
@contextmanager
def patience_without_limit() -> Generator[None]:
    """Let logs be flushed, closed and opened, however long that takes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(NonblockingWriter, "flush", _flush)
        patch.setattr(NonblockingWriter, "close", _close)
        patch.setattr(logs, "OPENED_WITHIN_S", None)
        yield


def _flush(self: NonblockingWriter, limit_s: float) -> bool:
    del limit_s
    with self._changed:
        return self._changed.wait_for(self._is_idle)


def _close(self: NonblockingWriter, limit_s: float) -> bool:
    with self._changed:
        self._deadline_s = self._deadline_s or limit_s
        self._changed.notify_all()
    self._thread.join()
    return True


class SetClock(LslClock):
    """Stands still until it is set."""

    def __init__(self, now_s: float = 1000.0) -> None:
        self.now_s = now_s  # What it tells.

    def __call__(self) -> float:
        """Return the time now, in seconds."""
        return self.now_s
