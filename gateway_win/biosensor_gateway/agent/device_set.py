"""Joins what belongs to one device of the settings while the agent runs."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from math import isfinite

import structlog

from biosensor_common.device_clock import ClockState
from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.agent.feed import Feed
from biosensor_gateway.agent.selection import device_name
from biosensor_gateway.agent.status import (
    ClockStatus,
    DeclaredStream,
    DeviceStatus,
    RefusedStatus,
    StreamStatus,
)
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.registry import declared, driver
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.streaming.events import EventKind
from biosensor_gateway.streaming.events.announcer import Announcer
from biosensor_gateway.streaming.events.device import DeviceEvents, device_facts
from biosensor_gateway.streaming.room import Room
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.clock import LSL_CLOCK, Clock

TICK_S = 0.05
KEPT_S = 1.0
"""How long the longest delay counts, at least; at most twice as long."""
TURNS = 3
"""Of the loop, which a packet may wait for: a virtual device's, to be read, to be noted."""
MOST_S = 0.5
"""What is held up for longer is a stall, and not a busy computer."""


class LoopLag:
    """How late the loop has been with what was due.

    On a busy computer what is due has to wait, and so has what comes meanwhile. Must be made in
    the loop, and run from then on.

    Parameters
    ----------
    clock
        Whose timers the loop goes by.
    """

    def __init__(self, clock: Clock = LSL_CLOCK) -> None:
        self._clock = clock
        self._due = clock()
        self._longest_s = self._longest_before_s = 0.0
        self._since = self._due

    def seconds(self) -> float:
        """Return the longest delay of the last second or two, with what is overdue now."""
        overdue_s = self._clock() - self._due
        return min(MOST_S, max(overdue_s, self._longest_s, self._longest_before_s))

    def packet_delay_s(self) -> float:
        """Return for how long a packet that comes now may have waited for the loop."""
        return TURNS * self.seconds()

    async def run(self) -> None:
        """Measure until cancelled."""
        while True:
            self._due = self._clock() + TICK_S
            await asyncio.sleep(TICK_S)
            self._note(self._clock())

    def _note(self, now: float) -> None:
        if now - self._since >= KEPT_S:
            self._longest_before_s, self._longest_s, self._since = self._longest_s, 0.0, now
        self._longest_s = max(self._longest_s, now - self._due)


class Device:
    """A device: who keeps it connected, and where its samples go.

    Attributes
    ----------
    supervisor
        Connects it, again and again.
    sink
        Its clock, outlets and counters.

    Parameters
    ----------
    own
        What its settings declare; empty where its sensor's declaration says it all.
    """

    def __init__(
        self, supervisor: Supervisor, sink: DeviceSink, own: Sequence[DeclaredStream] = ()
    ) -> None:
        self.supervisor = supervisor
        self.sink = sink
        self._own = list(own)
        self._events: DeviceEvents | None = None

    @classmethod
    def from_settings(cls, settings: DeviceSettings, clock: Clock = LSL_CLOCK) -> Device:
        """Make what a table of the settings asks for."""
        entry, spec = driver(settings.sensor), declared(settings)
        sink = DeviceSink(settings.identity, spec, clock)
        own = () if entry.declare is None else tuple(map(DeclaredStream.of, spec.streams))
        return cls(Supervisor(entry.make(settings, sink), sink), sink, own)

    @property
    def name(self) -> str:
        """What commands and events call it, ``sensor/unit``."""
        return device_name(self.sink.identity)

    @property
    def streams(self) -> int:
        """How many streams its declaration has."""
        return len(self.sink.spec.streams)

    @property
    def state(self) -> str:
        """Where it is on its way to streaming, or ``paused``."""
        return "paused" if self.sink.is_paused else self.supervisor.state.value

    def announce_to(self, announcer: Announcer) -> None:
        """Make events of what happens to it from now on."""
        self._events = self.sink.follow(announcer)
        self.supervisor.on_drop = self._events.dropped

    def close(self, announcer: Announcer) -> None:
        """Destroy its outlets; its supervisor has ended."""
        self.sink.close()
        if self._events is not None:
            announcer.unwatch(self._events.tick)

    def status(self) -> DeviceStatus:
        """Describe it: state, last error, clock, counters of each stream."""
        supervisor, sink = self.supervisor, self.sink
        return DeviceStatus(
            **asdict(sink.identity),
            state=supervisor.state.value,
            paused=sink.is_paused,
            since=sink.gate.since if sink.is_paused else supervisor.away_since,
            worn=None if self._events is None else self._events.is_worn,
            connections=supervisor.connections,
            error=supervisor.last_error,
            dropped_bytes=sink.dropped_bytes,
            battery_percent=sink.charge.percent if supervisor.is_connected else None,
            clock=_clock_status(sink.clock_state),
            refusals=RefusedStatus.of(sink.refusals),
            streams=_stream_status(sink),
            declared=self._own,
        )


def _clock_status(state: ClockState) -> ClockStatus | None:
    # JSON knows no NaN; before the first packet there is nothing to say.
    return ClockStatus(**asdict(state)) if isfinite(state.offset_s) else None


def _stream_status(sink: DeviceSink) -> dict[str, StreamStatus]:
    off = sink.off
    return {
        source: StreamStatus(
            **asdict(counters),
            nominal_hz=sink.nominal_rates[source],
            silent=source in off,
            refusals=RefusedStatus.of(sink.refused[source]),
        )
        for source, counters in sink.counters.items()
    }


_log = structlog.get_logger("biosensor_gateway.agent")


@dataclass(frozen=True, slots=True)
class DeviceChanges:
    """What other settings make of an agent's devices, by names as ``sensor/unit``.

    Attributes
    ----------
    added
        That begin.
    removed
        That end.
    restarted
        That end and begin again, because something in their entry is different.
    kept
        That stream on.
    """

    added: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    restarted: tuple[str, ...] = ()
    kept: tuple[str, ...] = ()


class DeviceSet:
    """Runs devices, and other ones on request.

    Parameters
    ----------
    devices
        To begin with, by their entry of the settings.
    room
        Has the streams that fit into this process.
    """

    def __init__(self, devices: Mapping[DeviceSettings, Device], room: Room) -> None:
        self._devices = dict(devices)
        self._room = room
        self._tasks: dict[Device, asyncio.Task[None]] = {}
        self._announcer: Announcer | None = None
        self._feed: Feed | None = None
        self._lag = LoopLag()
        self._broken: asyncio.Queue[BaseException] = asyncio.Queue()

    def __iter__(self) -> Iterator[Device]:
        return iter(tuple(self._devices.values()))

    def start(self, announcer: Announcer, feed: Feed) -> None:
        """Begin with all devices; announce what happens to them, and feed what they measure."""
        self._announcer, self._feed, self._lag = announcer, feed, LoopLag()
        for device in self:
            self._begin(device)

    def make_room(self) -> None:
        """Reserve room for the streams of all devices; say which are left out.

        Raises
        ------
        TransportError
            ``EXHAUSTED``, if no device has room.
        """
        left_out = self._room.share_out({each.name: each.streams for each in self})
        if left_out and not self.with_room:
            raise TransportError(TransportReason.EXHAUSTED, left_out)
        if left_out:
            _log.warning(left_out)

    @property
    def with_room(self) -> list[Device]:
        """The devices whose streams fit into this process."""
        return [device for device in self if self._room.has(device.name)]

    async def run(self) -> None:
        """Wait until cancelled.

        Raises
        ------
        Exception
            What ended a supervisor, which nothing should.
        """
        measuring = asyncio.create_task(self._lag.run())
        try:
            raise await self._broken.get()
        finally:
            measuring.cancel()

    def preview(self, entries: Iterable[DeviceSettings]) -> DeviceChanges:
        """Say what `change` would do."""
        wanted = [each for each in entries if each.enabled]
        ending = [device.name for entry, device in self._devices.items() if entry not in wanted]
        fresh = [device_name(each.identity) for each in wanted if each not in self._devices]
        kept = [device.name for entry, device in self._devices.items() if entry in wanted]
        return _changes(ending, fresh, kept)

    async def change(
        self, entries: Iterable[DeviceSettings], before_start: Callable[[], None]
    ) -> DeviceChanges:
        """Have the devices of other settings; those whose entry is the same stream on.

        Parameters
        ----------
        entries
            The settings of devices.
        before_start
            Called when the new devices are here, and none of them has begun.
        """
        wanted = [each for each in entries if each.enabled]
        ending = [device for entry, device in self._devices.items() if entry not in wanted]
        kept = {entry: device for entry, device in self._devices.items() if entry in wanted}
        self._devices = kept
        # Ports, addresses and source_ids must be free before others take them.
        await self._end(ending)
        fresh = {each: Device.from_settings(each) for each in wanted if each not in kept}
        self._devices = {each: kept.get(each) or fresh[each] for each in wanted}
        before_start()
        for device in fresh.values():
            self._announce(EventKind.DEVICE_ADDED, device)
            self._begin(device)
        return _changes(_names(ending), _names(fresh.values()), _names(kept.values()))

    async def close(self) -> None:
        """End all devices."""
        assert self._announcer is not None
        tasks = list(self._tasks.values())
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for device in self:
            device.sink.close()

    def _begin(self, device: Device) -> None:
        assert self._announcer is not None
        assert self._feed is not None
        device.announce_to(self._announcer)
        self._feed.watch(device.sink)
        device.supervisor.admit = partial(self._room.take, device.name, device.streams)
        device.sink.own_delay = self._lag.packet_delay_s
        task = asyncio.create_task(device.supervisor.run())
        task.add_done_callback(self._note_end)
        self._tasks[device] = task

    def _note_end(self, task: asyncio.Task[None]) -> None:
        if not task.cancelled() and (error := task.exception()) is not None:
            self._broken.put_nowait(error)

    async def _end(self, devices: Iterable[Device]) -> None:
        assert self._announcer is not None
        ending = {device: self._tasks.pop(device) for device in devices}
        for task in ending.values():
            task.cancel()
        await asyncio.gather(*ending.values(), return_exceptions=True)
        for device in ending:
            device.close(self._announcer)
            self._room.give_back(device.name)
            self._announce(EventKind.DEVICE_REMOVED, device)

    def _announce(self, kind: EventKind, device: Device) -> None:
        assert self._announcer is not None
        self._announcer.announce(kind, device_facts(device.sink.identity))
        word = "added" if kind is EventKind.DEVICE_ADDED else "removed"
        identity = device.sink.identity
        _log.info(f"the device was {word}", sensor=identity.sensor, unit=identity.unit)


def _names(devices: Iterable[Device]) -> list[str]:
    return [each.name for each in devices]


def _changes(before: Sequence[str], after: Sequence[str], kept: Iterable[str]) -> DeviceChanges:
    return DeviceChanges(
        added=tuple(name for name in after if name not in before),
        removed=tuple(name for name in before if name not in after),
        restarted=tuple(name for name in after if name in before),
        kept=tuple(kept),
    )
