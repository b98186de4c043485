"""Joins what belongs to one device of the settings while the agent runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from math import isfinite

from biosensor_common.device_clock import ClockState
from biosensor_gateway.agent.pauses.selection import device_name
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
from biosensor_gateway.streaming.events.announcer import Announcer
from biosensor_gateway.streaming.events.device import DeviceEvents
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.system.clock import LSL_CLOCK, Clock


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
