"""Makes events of what a device's sink and supervisor notice."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from numpy.typing import ArrayLike

from biosensor_common.spec import DeviceIdentity, DeviceInfo, SensorSpec
from biosensor_gateway.streaming.events import EventKind
from biosensor_gateway.streaming.events.announcer import Announcer
from biosensor_gateway.streaming.events.contact import ContactWatch
from biosensor_gateway.streaming.events.gaps import Gap, GapWatch
from biosensor_gateway.streaming.events.log_errors import log_errors
from biosensor_gateway.streaming.silence import Silence
from biosensor_gateway.system.clock import Clock


def device_facts(identity: DeviceIdentity) -> dict[str, str]:
    """Say which device an event is of, as every event of one does."""
    worn = {"participant": identity.participant, "label": identity.label}
    names = {"sensor": identity.sensor, "unit": identity.unit}
    return names | {key: value for key, value in worn.items() if value}


class DeviceEvents:
    """Is told by one device's sink what happens; neither raises nor waits.

    Of a paused device nothing is told that was measured, and no gap is followed. All times are
    LSL times in seconds.

    Parameters
    ----------
    announcer
        Where the events go.
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
            self._say(EventKind.PAUSED, facts={"kept": True})

    @property
    def is_worn(self) -> bool | None:
        """Whether the sensor is on the body; None while that is not known."""
        return self._contact.is_on if self._is_connected else None

    @log_errors
    def connected(self, info: DeviceInfo, changes: Mapping[str, tuple[object, object]]) -> None:
        """Announce the connection, and what has changed with it: before and after, by name."""
        self._is_connected = True
        self._connections += 1
        facts: dict[str, object] = {"connection": self._connections}
        if info.firmware_version:
            facts["firmware_version"] = info.firmware_version
        self._say(EventKind.CONNECTED, facts=facts)
        if changes:
            self._say(EventKind.SETTINGS_CHANGED, facts={"changes": dict(changes)})

    @log_errors
    def dropped(self, reason: str) -> None:
        """Announce the end of a connection, and the gap that it begins."""
        self._is_connected = False
        self._say(EventKind.DISCONNECTED, facts={"reason": reason})
        if not self._is_paused:
            self._say_gaps(self._gaps.interrupted())

    @log_errors
    def sampled(self, data_name: str, samples: ArrayLike, stamps: Sequence[float]) -> None:
        """Follow gaps, and whether the sensor is worn; of text there are stamps only."""
        self._gaps.sampled(data_name, stamps[0], stamps[-1], self._clock())
        for is_on, at in self._contact.changes(data_name, samples, stamps):
            kind = EventKind.ON_BODY if is_on else EventKind.OFF_BODY
            self._say(kind, at, {"channel": self._contact.channel})

    @log_errors
    def lost(self, data_name: str, count: int, since_s: float) -> None:
        """Add samples that are missing behind the one of `since_s` to a gap."""
        if not self._is_paused:
            self._gaps.lost(data_name, count, since_s)

    @log_errors
    def reanchored(self, cause: str, size_s: float | None, times: int = 1) -> None:
        """Announce a jump of the stamps, or several together; None if its size is unknown.

        Of several, the cause is the last one's and the size that of all.
        """
        facts: dict[str, object] = {"cause": cause}
        if size_s is not None:
            facts["seconds"] = round(size_s, 6)
        if times > 1:
            facts["times"] = times
        self._say(EventKind.CLOCK_REANCHORED, facts=facts)

    @log_errors
    def fell_silent(self, silence: Silence) -> None:
        """Announce streams that do not come, and what is done about it."""
        facts = {
            "streams": sorted(silence.streams),
            "seconds": round(silence.seconds, 1),
            "remedy": silence.remedy.value,
            **({"why": silence.why} if silence.why else {}),
        }
        self._say(EventKind.STREAMS_SILENT, facts=facts)

    @log_errors
    def came_back(self, streams: frozenset[str]) -> None:
        """Announce that they come again."""
        self._say(EventKind.STREAMS_BACK, facts={"streams": sorted(streams)})

    @log_errors
    def paused(self) -> None:
        """Announce the withdrawal; a gap ends with it."""
        self._is_paused = True
        now = self._clock()
        self._say_gaps(self._gaps.cut_off(now), paused=True)
        self._say(EventKind.PAUSED, now)

    @log_errors
    def resumed(self, send_from_s: float) -> None:
        """Announce the end of a pause, and a gap if nothing can come yet."""
        self._is_paused = False
        self._contact.forget()
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
                self._say(EventKind.GAP_START, gap.since)
            else:
                facts: dict[str, object] = {"lost": dict(gap.lost)}
                self._say(
                    EventKind.GAP_END, gap.until, facts | ({"paused": True} if paused else {})
                )

    def _say(
        self, kind: EventKind, at: float | None = None, facts: Mapping[str, object] | None = None
    ) -> None:
        self._announcer.announce(kind, self._names | dict(facts or {}), at)
