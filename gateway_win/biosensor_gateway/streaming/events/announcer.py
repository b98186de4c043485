"""Makes events from the observations of sinks and supervisors, and pushes them to an outlet."""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version

import numpy as np
from numpy.typing import ArrayLike

from biosensor_common.clocks import MonotonicStamps
from biosensor_common.quantities import ChannelRole
from biosensor_common.refusal import Refusals
from biosensor_common.ros_clock import measure_clock_pair
from biosensor_common.spec import DeviceIdentity, DeviceInfo, SensorSpec
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.streaming.events import EventKind
from biosensor_gateway.streaming.outlets import log_errors, spare_outlet
from biosensor_gateway.streaming.silence import Silence
from biosensor_gateway.system.clock import LSL_CLOCK, Clock

TICK_S = 0.25
LINGER_S = 0.25
"""How long the outlet stays after the last event, which LSL sends from a thread of its own."""
SETTLE_S = 2.0
"""Streams come back one after the other, each with its own count of what is missing."""


class Announcer:
    """The stream ``gateway/events``; its errors are logged and never raised.

    The outlet exists from the beginning. A heartbeat is sent at once, in every period and
    when a receiver connects, so that a recording has the state in which it began.

    Parameters
    ----------
    heartbeat_s
        Period in seconds; 0 for none.
    states
        Returns the state of every device by its name, for the heartbeat.
    problems
        Returns problems with the devices' data by device name, for the heartbeat.
    start
        Facts about the agent's start, also sent in each heartbeat.
    clock
        The LSL clock.
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
        self.started_s = round(clock(), 6)  # Its start in LSL seconds, as in each heartbeat.
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
        """Call a function a few times per second, with the LSL time."""
        self._watchers.append(tick)

    def unwatch(self, tick: Callable[[float], None]) -> None:
        """Stop calling the function."""
        self._watchers.remove(tick)

    @log_errors
    def announce(
        self, kind: EventKind, facts: Mapping[str, object], at: float | None = None
    ) -> None:
        """Send an event.

        Parameters
        ----------
        facts
            Further fields of the event, for JSON.
        at
            LSL time of the event in seconds; now if omitted.
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
        """Destroy the outlet after the announced events have been sent."""
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


def device_facts(identity: DeviceIdentity) -> dict[str, str]:
    """Return the fields that identify the device of an event."""
    worn = {"participant": identity.participant, "label": identity.label}
    names = {"sensor": identity.sensor, "unit": identity.unit}
    return names | {key: value for key, value in worn.items() if value}


class DeviceEvents:
    """Announces the events of one device, as its sink reports them; neither raises nor waits.

    During a pause neither measurements nor gaps are announced. All times are LSL times in
    seconds.
    """

    def __init__(
        self,
        identity: DeviceIdentity,
        spec: SensorSpec,
        clock: Clock,
        announcer: Announcer,
        *,
        is_paused: bool,
    ) -> None:
        self._clock = clock
        self._announcer = announcer
        self._names = device_facts(identity)
        self._gaps = GapWatch()
        self._contact = ContactWatch(spec)
        self._connections = 0
        self._is_connected = False
        self._is_paused = is_paused
        if self._is_paused:
            self._say(EventKind.PAUSED, facts={"kept": True})  # nothing is dropped: it is an event

    @property
    def is_worn(self) -> bool | None:
        """Whether the sensor is on the body; None while unknown."""
        return self._contact.is_on if self._is_connected else None

    @log_errors
    def connected(self, info: DeviceInfo, changes: Mapping[str, tuple[object, object]]) -> None:
        """Announce the connection, and changed settings: values before and after, by name."""
        self._is_connected = True
        self._connections += 1
        facts: dict[str, object] = {"connection": self._connections}
        if info.firmware_version:
            facts["firmware_version"] = info.firmware_version
        self._say(EventKind.CONNECTED, facts=facts)  # nothing is dropped: it is an event
        if changes:
            # nothing is dropped: it is an event
            self._say(EventKind.SETTINGS_CHANGED, facts={"changes": dict(changes)})

    @log_errors
    def dropped(self, reason: str) -> None:
        """Announce the end of a connection, and the start of a gap."""
        self._is_connected = False
        # nothing is dropped: it is an event
        self._say(EventKind.DISCONNECTED, facts={"reason": reason})
        if not self._is_paused:
            self._say_gaps(self._gaps.interrupted())

    @log_errors
    def sampled(self, data_name: str, samples: ArrayLike, stamps: Sequence[float]) -> None:
        """Update the gaps and whether the sensor is worn; text samples only have stamps."""
        self._gaps.sampled(data_name, stamps[0], stamps[-1], self._clock())
        for is_on, at in self._contact.changes(data_name, samples, stamps):
            kind = EventKind.ON_BODY if is_on else EventKind.OFF_BODY
            # nothing is dropped: it is an event
            self._say(kind, at, {"channel": self._contact.channel})

    @log_errors
    def lost(self, data_name: str, count: int, since_s: float) -> None:
        """Add samples that are missing after the one at `since_s` to a gap."""
        if not self._is_paused:
            self._gaps.lost(data_name, count, since_s)

    @log_errors
    def reanchored(self, cause: str, size_s: float | None, times: int = 1) -> None:
        """Announce a jump of the stamps, or several together; *seconds* is None if unknown.

        For several jumps, the cause is the last one's and the size is their sum.
        """
        facts: dict[str, object] = {"cause": cause}
        if size_s is not None:
            facts["seconds"] = round(size_s, 6)
        if times > 1:
            facts["times"] = times
        self._say(EventKind.CLOCK_REANCHORED, facts=facts)  # nothing is dropped: it is an event

    @log_errors
    def fell_silent(self, silence: Silence) -> None:
        """Announce silent streams, and the remedy that is tried."""
        facts = {
            "streams": sorted(silence.streams),
            "seconds": round(silence.seconds, 1),
            "remedy": silence.remedy.value,
            **({"why": silence.why} if silence.why else {}),
        }
        self._say(EventKind.STREAMS_SILENT, facts=facts)  # nothing is dropped: it is an event

    @log_errors
    def came_back(self, streams: frozenset[str]) -> None:
        """Announce that streams send again."""
        # nothing is dropped: it is an event
        self._say(EventKind.STREAMS_BACK, facts={"streams": sorted(streams)})

    @log_errors
    def paused(self) -> None:
        """Announce a pause, which ends a gap."""
        self._is_paused = True
        now = self._clock()
        self._say_gaps(self._gaps.cut_off(now), paused=True)
        self._say(EventKind.PAUSED, now)  # nothing is dropped: it is an event

    @log_errors
    def resumed(self, send_from_s: float) -> None:
        """Announce the end of a pause, and a gap if no samples can arrive yet."""
        self._is_paused = False
        self._contact.forget()
        # nothing is dropped: it is an event
        self._say(EventKind.RESUMED, facts={"send_from": round(send_from_s, 6)})
        self._gaps.go_on(send_from_s)
        if not self._is_connected and self._connections:
            self._say_gaps(self._gaps.interrupted())

    @log_errors
    def tick(self, now: float) -> None:
        """Announce gaps whose counts are complete."""
        if not self._is_paused:
            self._say_gaps(self._gaps.tick(now))

    def _say_gaps(self, gaps: Iterable[Gap], *, paused: bool = False) -> None:
        for gap in gaps:
            if gap.until is None:
                self._say(EventKind.GAP_START, gap.since)  # nothing is dropped: it is an event
            else:
                facts: dict[str, object] = {"lost": dict(gap.lost)}
                # nothing is dropped: it is an event
                self._say(
                    EventKind.GAP_END, gap.until, facts | ({"paused": True} if paused else {})
                )

    def _say(
        self, kind: EventKind, at: float | None = None, facts: Mapping[str, object] | None = None
    ) -> None:
        self._announcer.announce(kind, self._names | dict(facts or {}), at)


class ContactWatch:
    """Monitors the first channel of one device that has the role of contact.

    Attributes
    ----------
    channel
        Its label; empty if the sensor has none.
    """

    def __init__(self, spec: SensorSpec) -> None:
        first = next(spec.channels_of(ChannelRole.CONTACT), ("", 0, ""))
        self._data_name, self._index, self.channel = first
        self.is_on: bool | None = None  # Whether the sensor is on the body; None while unknown.

    def forget(self) -> None:
        """Report the next value as a change, whatever it is."""
        self.is_on = None

    def changes(
        self, data_name: str, samples: ArrayLike, stamps: Sequence[float]
    ) -> Iterator[tuple[bool, float]]:
        """Yield whether the sensor is on the body, and since when, at each change.

        Parameters
        ----------
        data_name
            Any stream of the device.
        samples : array_like, shape (n_samples, n_channels) or (n_samples,)
        stamps : sequence of float, length n_samples
        """
        if data_name != self._data_name:
            return  # nothing is dropped: another stream tells nothing of contact
        values = np.asarray(samples, np.float64).reshape(len(stamps), -1)[:, self._index]
        for value, stamp in zip(values.tolist(), stamps, strict=True):
            # NaN is unknown.
            if not math.isnan(value) and bool(value) != self.is_on:
                self.is_on = bool(value)
                yield self.is_on, stamp


@dataclass(slots=True)
class Gap:
    """A period in which samples are missing; LSL times in seconds."""

    since: float  # Time of the newest sample before it.
    until: float | None = None  # Time of the first sample after it; None while there is none.
    # Counted missing samples by data name.
    lost: Counter[str] = field(default_factory=Counter[str])


class GapWatch:
    """Finds gaps, from broken connections and from samples missing within a connection."""

    def __init__(self) -> None:
        self._newest: float | None = None
        self._begin = -math.inf
        self._gap: Gap | None = None
        self._is_interruption = False
        self._is_announced = False
        self._awaited: set[str] = set()
        self._settled_s = math.inf

    def sampled(self, data_name: str, first: float, last: float, now: float) -> None:
        """Note samples of a stream by the times of the first and the last one."""
        gap = self._gap
        if gap is not None and (
            gap.until is None if self._is_interruption else data_name in self._awaited
        ):
            self._awaited.discard(data_name)
            if gap.until is None:
                self._settled_s = now + SETTLE_S
            gap.until = max(first, gap.since, gap.until or -math.inf)
        self._newest = last if self._newest is None else max(self._newest, last)

    def lost(self, data_name: str, count: int, since: float) -> None:
        """Note samples that are missing after the one at `since`."""
        since = max(since, self._begin)
        if self._gap is None:
            self._open(since, is_interruption=False)
        assert self._gap is not None
        if not self._is_announced:
            self._gap.since = min(self._gap.since, since)
        self._gap.lost[data_name] += count
        self._awaited.add(data_name)

    def interrupted(self) -> Iterator[Gap]:
        """Begin a gap at the newest sample, if there ever was one; yield gaps to announce."""
        if self._newest is None or (self._is_interruption and self._is_open):
            return  # nothing is dropped: nothing has come that could be missed
        yield from self._finished(self._newest)
        self._open(self._newest, is_interruption=True)
        yield from self._begun()

    def tick(self, now: float) -> Iterator[Gap]:
        """Yield a gap when its start should be announced, and again for its end."""
        yield from self._begun()
        if not self._is_open and now >= self._settled_s:
            yield from self._finished(now)

    def cut_off(self, at: float) -> Iterator[Gap]:
        """End the current gap, if any, because no samples are expected any more."""
        yield from self._finished(at)

    def go_on(self, at: float) -> None:
        """Expect samples again, from this time on."""
        self._newest = self._begin = at

    @property
    def _is_open(self) -> bool:
        return self._gap is not None and self._gap.until is None

    def _open(self, since: float, *, is_interruption: bool) -> None:
        self._gap = Gap(since)
        self._is_interruption = is_interruption
        self._is_announced = False
        self._awaited.clear()
        self._settled_s = math.inf

    def _begun(self) -> Iterator[Gap]:
        if self._gap is not None and not self._is_announced:
            self._is_announced = True
            yield Gap(self._gap.since)

    def _finished(self, at: float) -> Iterator[Gap]:
        yield from self._begun()
        gap, self._gap = self._gap, None
        if gap is not None:
            until = max(at, gap.since) if gap.until is None else gap.until
            yield Gap(gap.since, until, gap.lost)
