"""Pushes events into their outlet, and heartbeats."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Callable, Mapping
from importlib.metadata import version

from biosensor_common.clocks import MonotonicStamps
from biosensor_common.refusal import Refusals
from biosensor_common.ros_clock import measure_clock_pair
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.streaming.events import EventKind
from biosensor_gateway.streaming.outlets import log_errors, spare_outlet
from biosensor_gateway.system.clock import LSL_CLOCK, Clock

TICK_S = 0.25
LINGER_S = 0.25
"""How long the outlet stays after the last event, which LSL sends from a thread of its own."""


class Announcer:
    """The stream ``gateway/events``. Nothing that goes wrong in it is raised.

    The outlet exists from the beginning. A heartbeat comes at once, in every period and
    when somebody begins to receive, so that a recording tells in which state it began.

    Parameters
    ----------
    heartbeat_s
        Period in seconds; 0 for none.
    states
        Tells the state of every device by its name, for the heartbeat.
    problems
        Tells what is wrong with what devices send, by name, for the heartbeat.
    start
        What there is to say of the agent's start, in each heartbeat, too.
    clock
        Tells when something happens, and when a heartbeat is due.

    Attributes
    ----------
    started_s
        When it began, in LSL seconds, as in each heartbeat.
    """

    def __init__(
        self,
        heartbeat_s: float,
        states: Callable[[], Mapping[str, str]],
        problems: Callable[[], Mapping[str, object]] = dict,
        start: Mapping[str, object] | None = None,
        clock: Clock = LSL_CLOCK,
    ) -> None:
        self._clock = clock
        self._period_s = heartbeat_s
        self._states = states
        self._problems = problems
        self._watchers: list[Callable[[float], None]] = []
        self._stamps = MonotonicStamps()
        self.started_s = round(clock(), 6)
        self._due_s = -math.inf
        self._had_consumers = False
        self.refusals = Refusals(clock=clock)
        self._outlet = spare_outlet("events", self.refusals, clock)
        self._session = "" if self._outlet is None else self._outlet.session
        self._start = dict(start or {})
        facts = {"version": version("biosensor-gateway"), **self._start, **self._clock_pair()}
        self.announce(EventKind.AGENT_STARTED, facts)
        self._tick()

    @property
    def counters(self) -> dict[str, Counters]:
        """Counters of the stream by source_id."""
        return {} if self._outlet is None else {self._outlet.source_id: self._outlet.counters}

    def watch(self, tick: Callable[[float], None]) -> None:
        """Have something called a few times a second, with the LSL time."""
        self._watchers.append(tick)

    def unwatch(self, tick: Callable[[float], None]) -> None:
        """Call it no more."""
        self._watchers.remove(tick)

    @log_errors
    def announce(
        self, kind: EventKind, facts: Mapping[str, object], at: float | None = None
    ) -> None:
        """Send an event.

        Parameters
        ----------
        facts
            What belongs to the event, for JSON.
        at
            LSL time in seconds at which it happened; now if it is not said.
        """
        if self._outlet is None:
            # nothing is dropped: `spare_outlet` has reported that there is no stream
            return
        happened = self._clock() if at is None else at
        content = {"event": kind.value, **facts, "lsl_time": round(happened, 6)}
        text = json.dumps(content, separators=(",", ":"), allow_nan=False)
        (stamp,) = self._stamps.apply([happened])
        self._outlet.push_text(text, stamp)

    async def run(self) -> None:
        """Send heartbeats until cancelled."""
        while True:
            self._tick()
            await asyncio.sleep(TICK_S)

    async def end(self) -> None:
        """Destroy the outlet, when what was announced has been sent."""
        if self._outlet is None:
            # nothing is dropped: `spare_outlet` has reported that there is no stream
            return
        if self._outlet.have_consumers():
            await asyncio.sleep(LINGER_S)
        self._outlet.close()
        self._outlet = None

    @log_errors
    def _tick(self) -> None:
        now = self._clock()
        for watcher in tuple(self._watchers):
            watcher(now)
        if self._outlet is None or not self._period_s:
            # nothing is dropped: none is wanted, or there is no stream
            return
        has_consumers = self._outlet.have_consumers()
        has_come = has_consumers and not self._had_consumers
        self._had_consumers = has_consumers
        if has_come or now >= self._due_s:
            self._due_s = now + self._period_s
            told: dict[str, object] = {"agent_started": self.started_s, **self._start}
            if self._session:
                told["session"] = self._session
            told["devices"] = dict(self._states())
            if problems := dict(self._problems()):
                told["problems"] = problems
            self.announce(EventKind.HEARTBEAT, {**told, **self._clock_pair()})

    def _clock_pair(self) -> dict[str, object]:
        return measure_clock_pair(time.time_ns, self._clock).as_facts()
