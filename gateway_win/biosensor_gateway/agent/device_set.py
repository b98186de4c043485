"""The devices of a running agent, and how they change when it reads its settings again."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from math import isfinite
from typing import Any

import structlog

from biosensor_common import naming
from biosensor_common.device_clock import ClockState
from biosensor_common.errors import ConfigError, ConfigReason, TransportError, TransportReason
from biosensor_common.refusal import LATELY_S, Refused
from biosensor_gateway.agent.device_states import State, described, device_name
from biosensor_gateway.agent.feed import Feed
from biosensor_gateway.agent.status import (
    ClockStatus,
    DeclaredStream,
    DeviceStatus,
    RefusedStatus,
    StreamStatus,
)
from biosensor_gateway.agent.supervisor import Supervisor
from biosensor_gateway.devices.registry import declared, driver
from biosensor_gateway.settings.models import DeviceSettings, GatewaySettings
from biosensor_gateway.streaming.events import EventKind
from biosensor_gateway.streaming.events.announcer import Announcer, DeviceEvents, device_facts
from biosensor_gateway.streaming.room import Room
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.system.device_log import names_in_log

TICK_S = 0.05
KEPT_S = 1.0
"""How long the longest delay is remembered: at least this, and at most twice as long."""
TURNS = 3
"""Turns of the loop that a packet may wait for: to be sent by a virtual device, read, and noted."""
MOST_S = 0.5
"""A longer delay is a stall, which a busy computer does not explain."""


class LoopLag:
    """Measures how late the event loop runs its timers.

    A packet that arrives on a busy computer waits as long as a timer does. Must be made in the
    loop, and run from then on.
    """

    def __init__(self) -> None:
        self._scheduled = LSL_CLOCK()
        self._longest_s = self._longest_before_s = 0.0
        self._since = self._scheduled

    def seconds(self) -> float:
        """Return the longest delay of the last one or two seconds, the current one included."""
        overdue_s = LSL_CLOCK() - self._scheduled
        return min(MOST_S, max(overdue_s, self._longest_s, self._longest_before_s))

    def packet_delay_s(self) -> float:
        """Return how long a packet that is received now may have waited for the loop."""
        return TURNS * self.seconds()

    async def run(self) -> None:
        """Measure until cancelled."""
        while True:
            self._scheduled = LSL_CLOCK() + TICK_S
            await asyncio.sleep(TICK_S)
            self._note(LSL_CLOCK())

    def _note(self, now: float) -> None:
        # Two intervals in turn, so that a delay is remembered for at least one whole interval.
        if now - self._since >= KEPT_S:
            self._longest_before_s, self._longest_s, self._since = self._longest_s, 0.0, now
        self._longest_s = max(self._longest_s, now - self._scheduled)


Problem = dict[str, object]
"""A sentence ``what`` in heartbeats, and ``last``, the LSL time in s of what does not last."""


def problem(refused: Refused) -> Problem:
    """Describe something refused for heartbeats."""
    lasts = {} if refused.what.stands else {"last": round(refused.last_s, 6)}
    return {"what": refused.sentence, **lasts}


class Device:
    """A device with its supervisor and its sink.

    Parameters
    ----------
    own
        Streams that its settings declare; empty if the sensor's declaration has them all.
    """

    def __init__(
        self, supervisor: Supervisor, sink: DeviceSink, own: Sequence[DeclaredStream] = ()
    ) -> None:
        self.supervisor = supervisor  # Keeps the device connected.
        self.sink = sink  # Clock, outlets and counters of the device.
        self._own = list(own)
        self._events: DeviceEvents | None = None

    @classmethod
    def from_settings(cls, settings: DeviceSettings) -> Device:
        """Make the device of an entry of the settings."""
        entry, spec = driver(settings.sensor), declared(settings)
        sink = DeviceSink(settings.identity, spec)
        own = () if entry.declare is None else tuple(map(DeclaredStream.of, spec.streams))
        return cls(Supervisor(entry.make(settings, sink), sink), sink, own)

    @property
    def name(self) -> str:
        """Name of the device in commands and events, ``sensor/unit``."""
        return device_name(self.sink.identity)

    @property
    def streams(self) -> int:
        """Number of streams in the device's declaration."""
        return len(self.sink.spec.streams)

    @property
    def state(self) -> str:
        """State of the supervisor, or ``paused``."""
        return "paused" if self.sink.is_paused else self.supervisor.state.value

    @property
    def room_name(self) -> str:
        """Name that is unique also where two people wear a virtual device of one kind."""
        return described(self.sink.identity)

    @property
    def lsl_names(self) -> list[str]:
        """LSL names of its streams."""
        identity = self.sink.identity
        return [naming.lsl_name(identity, each.data_name) for each in self.sink.spec.streams]

    def problems(self, lately_s: float = LATELY_S) -> list[Problem]:
        """Return the problems of its data, as reported in heartbeats.

        Nothing is reported about a paused device.

        Parameters
        ----------
        lately_s
            How long a momentary problem is reported.
        """
        supervisor = self.supervisor
        if self.sink.is_paused:
            return []
        found: list[Problem] = []
        if supervisor.state is State.STREAMING and supervisor.last_error:
            found.append({"what": supervisor.last_error})
        return [*found, *map(problem, self.sink.refusals.within(lately_s))]

    def announce_to(self, announcer: Announcer) -> None:
        """Begin to announce the device's events."""
        self._events = self.sink.follow(announcer)
        self.supervisor.on_drop = self._events.dropped

    def close(self, announcer: Announcer) -> None:
        """Destroy the device's outlets, after its supervisor has ended."""
        self.sink.close()
        if self._events is not None:
            announcer.unwatch(self._events.tick)

    def status(self) -> DeviceStatus:
        """Return the device's state, last error, clock, and the counters of each stream."""
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
    # Before the first packet the offset is NaN, which JSON does not have.
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
    """The changes that new settings make to an agent's devices, as ``sensor/unit``."""

    added: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    restarted: tuple[str, ...] = ()  # Devices whose entry in the settings has changed.
    kept: tuple[str, ...] = ()  # Devices that go on streaming.


class DeviceSet:
    """Runs the devices of an agent, and replaces them when the settings change.

    Parameters
    ----------
    devices
        The first devices, by their entry of the settings.
    room
        Limits the number of streams in this process.
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
        """Start all devices, announce their events, and feed their samples."""
        self._announcer, self._feed, self._lag = announcer, feed, LoopLag()
        for device in self:
            self._begin(device)

    def make_room(self) -> None:
        """Reserve room for the devices' streams; log which devices are left out.

        Raises
        ------
        TransportError
            ``EXHAUSTED`` if no device has room.
        """
        left_out = self._room.share_out({each.room_name: each.streams for each in self})
        if left_out and not self.with_room:
            raise TransportError(TransportReason.EXHAUSTED, left_out)
        if left_out:
            _log.warning(left_out)

    @property
    def with_room(self) -> list[Device]:
        """The devices whose streams fit into this process."""
        return [device for device in self if self._room.has(device.room_name)]

    async def run(self) -> None:
        """Wait until cancelled.

        Raises
        ------
        Exception
            If a supervisor ends by itself, which is a defect.
        """
        measuring = asyncio.create_task(self._lag.run())
        try:
            raise await self._broken.get()
        finally:
            measuring.cancel()

    def preview(self, entries: Iterable[DeviceSettings]) -> DeviceChanges:
        """Return the changes that `change` would make."""
        wanted = [each for each in entries if each.enabled]
        ending = [device.name for entry, device in self._devices.items() if entry not in wanted]
        fresh = [device_name(each.identity) for each in wanted if each not in self._devices]
        kept = [device.name for entry, device in self._devices.items() if entry in wanted]
        return _changes(ending, fresh, kept)

    async def change(
        self, entries: Iterable[DeviceSettings], before_start: Callable[[], None]
    ) -> DeviceChanges:
        """Replace the devices by those of new settings; those with the same entry are kept.

        Parameters
        ----------
        entries
            Settings of all devices.
        before_start
            Called when the new devices are made, before any of them starts.
        """
        wanted = [each for each in entries if each.enabled]
        ending = [device for entry, device in self._devices.items() if entry not in wanted]
        kept = {entry: device for entry, device in self._devices.items() if entry in wanted}
        self._devices = kept
        # Removed devices end first, because a new one may use the same port, address or source_id.
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
        device.supervisor.admit = partial(self._room.take, device.room_name, device.streams)
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
            self._room.give_back(device.room_name)
            self._announce(EventKind.DEVICE_REMOVED, device)

    def _announce(self, kind: EventKind, device: Device) -> None:
        assert self._announcer is not None
        self._announcer.announce(kind, device_facts(device.sink.identity))
        word = "added" if kind is EventKind.DEVICE_ADDED else "removed"
        _log.info(f"the device was {word}", **names_in_log(device.sink.identity))


def _names(devices: Iterable[Device]) -> list[str]:
    return [each.name for each in devices]


def _changes(before: Sequence[str], after: Sequence[str], kept: Iterable[str]) -> DeviceChanges:
    return DeviceChanges(
        added=tuple(name for name in after if name not in before),
        removed=tuple(name for name in before if name not in after),
        restarted=tuple(name for name in after if name in before),
        kept=tuple(kept),
    )


ANSWERED_WITHIN_S = 3.0
"""How long the answer waits; a device may take longer to disconnect, and the change goes on."""
ReadSettings = Callable[[], GatewaySettings]
"""Reads the settings file again.

Raises
------
ConfigError
    If the file is wrong.
"""
_AT_ONCE = frozenset({"markers"})
"""Sections of the settings, besides the devices, that apply to a running agent at once."""


class SettingsReload:
    """Reads the settings again on request, and applies changed devices and marker buttons.

    A broken file changes nothing, and the answer says what is wrong with it.

    Parameters
    ----------
    settings
        Settings with which the agent was started.
    read
        Reads the settings again; None if there is no file, as with virtual devices.
    change
        Applies new settings to the devices and the markers.
    preview
        Returns the changes that `change` would make.
    """

    def __init__(
        self,
        settings: GatewaySettings,
        read: ReadSettings | None,
        change: Callable[[GatewaySettings], Awaitable[DeviceChanges]],
        preview: Callable[[GatewaySettings], DeviceChanges],
    ) -> None:
        self._started_with = self._newest = settings
        self._read = read
        self._change, self._preview = change, preview
        self._busy = asyncio.Lock()
        self._task: asyncio.Task[DeviceChanges] | None = None

    @property
    def is_virtual(self) -> bool:
        """Whether there is no file to read."""
        return self._read is None

    async def command(self, _arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Read the settings and apply what has changed.

        Returns
        -------
        Mapping
            ``added``, ``removed``, ``restarted`` and ``kept``: names of devices; ``now``: other
            changed sections that apply already; ``later``: changed sections that apply from the
            agent's next start on; ``pending``: whether devices are still ending.
        """
        if self._task is not None and not self._task.done():
            message = "the settings are already being read again; try again in a few seconds"
            raise ConfigError(ConfigReason.IN_USE, message)
        settings = await self._read_again()
        self._task = asyncio.create_task(self._changed(settings))
        done, _ = await asyncio.wait({self._task}, timeout=ANSWERED_WITHIN_S)
        changes = self._task.result() if done else DeviceChanges()
        now = _different(self._newest, settings, _AT_ONCE)
        later = _different(self._started_with, settings, _sections() - _AT_ONCE)
        self._newest = settings
        return {**asdict(changes), "now": now, "later": later, "pending": not done}

    async def preview(self, _arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the devices that `command` would change, under the same keys."""
        return asdict(self._preview(await self._read_again()))

    async def _read_again(self) -> GatewaySettings:
        if self._read is None:
            message = "this agent runs virtual devices, which have no settings file"
            raise ConfigError(ConfigReason.NOT_FOUND, message)
        return await asyncio.to_thread(self._read)

    async def _changed(self, settings: GatewaySettings) -> DeviceChanges:
        async with self._busy:
            changes = await self._change(settings)
        _log.info("the settings were read again", **asdict(changes))
        return changes


def _sections() -> set[str]:
    return GatewaySettings.model_fields.keys() - {"devices"}


def _different(
    before: GatewaySettings, after: GatewaySettings, sections: Iterable[str]
) -> list[str]:
    return [name for name in sorted(sections) if getattr(before, name) != getattr(after, name)]
