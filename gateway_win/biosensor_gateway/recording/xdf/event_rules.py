"""Checks a recording against the device events that the capture agent sent into it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple, cast

from biosensor_common.naming import AGENT
from biosensor_common.plausible import finite
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.device_states import CONNECTED, STATE_WORDS, device_name, holders
from biosensor_gateway.recording.xdf.counters import newest_of_each_kind
from biosensor_gateway.recording.xdf.findings import Finding, Level
from biosensor_gateway.recording.xdf.header import RecordedHeader
from biosensor_gateway.recording.xdf.measuring import Gap, Gaps
from biosensor_gateway.recording.xdf.recording import Recording
from biosensor_gateway.recording.xdf.report import Extent, Measured
from biosensor_gateway.streaming.events import EventKind

PAUSED, _NOT_CONNECTED = "paused", "not connected"
_LINK = {EventKind.CONNECTED: "", EventKind.DISCONNECTED: _NOT_CONNECTED}
OF_ANOTHER_AGENT = (
    "it belongs to another agent, which runs at the same time with the same source_id, as in "
    "another LSL session: data from then on may be another person's"
)
_MOST_SPELLS = 3
_ESTIMATED, _MOST_STRAY = 1.02, 2
"""By how much, and by how many samples, a count of lost ones may exceed the estimate of gaps."""
_EDGE_S = 3.0
"""A device's last packet before a pause comes a while later, and after it 1 s is left out."""


def tells_devices(recording: Recording) -> bool:
    """Whether a recording contains an agent's list of devices."""
    events = (each.texts for each in recording.streams if each.header.is_events)
    return any(_states(each) for each in events)


def judge_devices(streams: Sequence[Measured], extent: Extent) -> Iterator[Finding]:
    """Report devices of an agent that were not recorded, or not until the end."""
    for events in streams:
        if not events.stream.header.is_events:
            continue
        own = [each for each in streams if _is_beside(each, events)]
        yield from _another_agent(events, extent)
        yield from _left_out(own, events)
        yield from _removed(own, events, extent)
        yield from _jumped(own, events, extent)
        yield from _silent(own, events, extent)
        yield from _refused(own, events, extent)


@dataclass(frozen=True, slots=True)
class Absence:
    """When a device or program did not send, and the finding that reports it."""

    finding: Finding
    device: DeviceIdentity | None  # None for the agent and all its devices, or for a program.
    hostname: str  # Of their computer.
    spells: tuple[Spell, ...]
    source_ids: frozenset[str] = frozenset()  # Of the program's streams; empty for an agent.

    def concerns(self, header: RecordedHeader) -> bool:
        """Whether a stream is of this device, agent or program."""
        if self.source_ids:
            return header.hostname == self.hostname and header.source_id in self.source_ids
        is_beside = header.is_of_agent and header.hostname == self.hostname
        return is_beside and self.device in (None, header.identity)


def absences(
    streams: Sequence[Measured], extent: Extent, without: Collection[str] = ()
) -> list[Absence]:
    """Return when agents did not run, and when each recorded device was away.

    Parameters
    ----------
    without
        source_ids of sensors that the user has excluded.
    """
    found: list[Absence] = []
    for events in streams:
        if events.stream.header.is_events:
            own = [each for each in streams if _is_beside(each, events)]
            log = EventLog.of(events.stream.texts, _recorded(own))
            found += _restarted(log, events, extent)
            found += _away(log, own, events, extent, without)
    return found


def consequence(
    finding: Finding, measured: Measured, extent: Extent, away: Sequence[Absence]
) -> Finding:
    """Return a finding about a stream, with the absence that explains all of it, if any."""
    own = [each for each in away if each.concerns(measured.stream.header)]
    # After a restart of the clock, samples are on another clock than events.
    if not own or measured.figures.offsets.resets:
        return finding
    levels = list(Level)
    causes = [e for e in own if levels.index(e.finding.level) <= levels.index(finding.level)]
    if finding.code == "restarted":
        causes = [each for each in causes if each.device is None]
    else:
        missing = _missing_times(finding.code, measured, extent)
        spells = [spell for each in own for spell in each.spells]
        if not all(_is_within(gap, spells) for gap in missing):
            return finding
        causes = [e for e in causes if any(_overlap_s(gap, e.spells) for gap in missing)]
    return replace(finding, part_of=causes[0].finding.text) if causes else finding


def _missing_times(code: str, measured: Measured, extent: Extent) -> Sequence[Gap]:
    """Return the times in which samples are missing according to findings with this code."""
    figures = measured.figures
    gaps = figures.gaps
    if code == "paused":
        return figures.pauses.listed
    if code in ("gaps", "held-up") and gaps.count == len(gaps.listed):
        return gaps.listed
    if code == "lost" and measured.counters is not None and gaps.count == len(gaps.listed):
        # Of the gaps an estimate is known, of some devices also the count.
        is_in_gaps = measured.counters.lost <= gaps.lost * _ESTIMATED + _MOST_STRAY
        return gaps.listed if is_in_gaps else ()
    if figures.first is None or figures.last is None:
        begin = extent.begin - measured.recorder_offset_s
        return [Gap(begin, extent.length_s, 0)] * (code == "no-samples")
    late_s = extent.since_begin(figures.first, measured)
    if code == "begins-late":
        return [Gap(figures.first - late_s, late_s, 0)]
    early_s = extent.length_s - extent.since_begin(figures.last, measured)
    return [Gap(figures.last, early_s, 0)] * (code == "ends-early")


def without_pauses(streams: Sequence[Measured]) -> list[Measured]:
    """Remove the gaps during pauses of the device from each stream's gaps."""
    pauses: dict[str, list[Spell]] = {}
    for events in streams:
        if events.stream.header.is_events:
            own = [each for each in streams if _is_beside(each, events)]
            spells = EventLog.of(events.stream.texts, _recorded(own)).spells
            for each in own:
                identity = each.stream.header.identity
                of_one = spells.get(identity, []) if identity else []
                pauses.setdefault(each.stream.header.source_id, []).extend(of_one)
    return [_without(each, pauses.get(each.stream.header.source_id, ())) for each in streams]


def _without(measured: Measured, pauses: Sequence[Spell]) -> Measured:
    figures = measured.figures
    # After a restart of the clock, gaps are on another clock than events.
    if figures.offsets.resets:
        return measured
    rest, paused = split_pauses(figures.gaps, pauses)
    return replace(measured, figures=replace(figures, gaps=rest, pauses=paused))


def split_pauses(gaps: Gaps, spells: Sequence[Spell]) -> tuple[Gaps, Gaps]:
    """Split the gaps of a device's stream into those outside and those during its pauses."""
    pauses = [each for each in spells if each.how == PAUSED]
    paused = tuple(gap for gap in gaps.listed if any(_is_within(gap, [each]) for each in pauses))
    told = Gaps(len(paused), 0, sum(gap.length_s for gap in paused), paused)
    rest = Gaps(
        gaps.count - told.count,
        gaps.lost - sum(gap.lost for gap in paused),
        gaps.total_s - told.total_s,
        tuple(gap for gap in gaps.listed if gap not in paused),
    )
    return rest, told


def are_within(gaps: Gaps, spells: Sequence[Spell]) -> bool:
    """Whether all gaps of a device's stream lack no more than was not sent in these times."""
    are_listed = gaps.count == len(gaps.listed) > 0
    return are_listed and all(_is_within(gap, spells) for gap in gaps.listed)


def _is_within(gap: Gap, spells: Sequence[Spell]) -> bool:
    """Whether a gap lacks no more than was not sent in these times."""
    covered_s = _overlap_s(gap, spells)
    return covered_s > 0 and gap.length_s - covered_s <= _EDGE_S


def _overlap_s(gap: Gap, spells: Sequence[Spell]) -> float:
    """Return the part of a gap that is in these times, in s."""
    begin, end = gap.after, gap.after + gap.length_s
    parts = sorted(
        (
            begin if each.since is None else max(begin, each.since),
            end if each.until is None else min(end, each.until),
        )
        for each in spells
    )
    covered_s, reached = 0.0, begin
    for since, until in parts:
        covered_s += max(0.0, until - max(since, reached))
        reached = max(reached, until)
    return covered_s


def pauses_told(
    texts: Sequence[str], recorded: Sequence[DeviceIdentity], begin_s: float
) -> Iterator[str]:
    """Yield a sentence for each recorded device that was paused.

    Parameters
    ----------
    texts
        Events of an agent, in the order of the file.
    begin_s
        Begin of the recording on the agent's clock, in seconds.
    """
    for device, spells in EventLog.of(texts, recorded).spells.items():
        paused = [each for each in spells if each.how == PAUSED]
        if paused:
            said = _spells_text(paused, lambda at: at - begin_s)
            yield f"{_named(device)} was {said}: data missing then was not sent, and is not lost"


def other_agent_told(texts: Sequence[str], begin_s: float) -> str:
    """Return the time since which another agent is recorded, as a sentence; empty if none is.

    Parameters
    ----------
    texts, begin_s
        As for `pauses_told`.
    """
    since_s = EventLog.of(texts, ()).other_agent_since()
    return "" if since_s is None else f"from {since_s - begin_s:.1f} s on {OF_ANOTHER_AGENT}"


def _is_beside(stream: Measured, events: Measured) -> bool:
    header = stream.stream.header
    return header.is_of_agent and header.hostname == events.stream.header.hostname


def _another_agent(events: Measured, extent: Extent) -> Iterator[Finding]:
    """Report that the recorder continued with the stream of another agent."""
    since_s = EventLog.of(events.stream.texts, ()).other_agent_since()
    if since_s is not None:
        text = f"from {extent.since_begin(since_s, events):.1f} s on {OF_ANOTHER_AGENT}"
        yield Finding(Level.ERROR, "another-agent", events.name, text)


def _left_out(own: Sequence[Measured], events: Measured) -> Iterator[Finding]:
    recorded = _recorded(own)
    is_counted = any(each.stream.header.is_counters for each in own)
    for device, states in _states(events.stream.texts).items():
        if holders(device, recorded):
            continue
        if not CONNECTED & states.keys():
            how = ", ".join(STATE_WORDS.get(each, each) for each in states)
            text = f"{device} was never available ({how}), so none of its data was recorded"
            yield Finding(Level.WARNING, "absent", "", text)
        elif not is_counted:
            # Otherwise each missing stream is reported by name.
            text = f"the agent also had {device}, from which nothing was recorded"
            yield Finding(Level.ERROR, "left-out", "", text)


def _removed(own: Sequence[Measured], events: Measured, extent: Extent) -> Iterator[Finding]:
    recorded = _recorded(own)
    ended: dict[DeviceIdentity, float] = {}
    for event in _events(events.stream.texts):
        identity = _identity(event)
        if event.get("event") == EventKind.DEVICE_REMOVED and identity in recorded:
            ended[identity] = _time(event)
        elif event.get("event") == EventKind.DEVICE_ADDED:
            # A device added again under the same name is recorded again.
            ended.pop(identity, None)
    gone = {**EventLog.of(events.stream.texts, recorded).gone, **ended}
    for identity, at in sorted(gone.items(), key=lambda each: each[1]):
        text = (
            f"{_named(identity)} was removed or renamed in the settings at "
            f"{extent.since_begin(at, events):.1f} s, and none of its data was recorded since"
        )
        yield Finding(Level.ERROR, "removed", "", text)


def _restarted(log: EventLog, events: Measured, extent: Extent) -> Iterator[Absence]:
    """Report restarts of the agent, each between two heartbeats."""
    spells = tuple(log.restarts)
    if spells:
        said = ", ".join(
            f"between {extent.since_begin(each.since or 0.0, events):.1f} s and "
            f"{extent.since_begin(each.until or 0.0, events):.1f} s"
            for each in spells[:_MOST_SPELLS]
        )
        more = len(spells) - _MOST_SPELLS
        text = f"the agent was restarted {said}" + (f" and {more} more times" if more > 0 else "")
        host = events.stream.header.hostname
        yield Absence(Finding(Level.WARNING, "restarted", "", text), None, host, spells)


def _away(
    log: EventLog,
    own: Sequence[Measured],
    events: Measured,
    extent: Extent,
    without: Collection[str],
) -> Iterator[Absence]:
    """Report when each recorded device was paused or not connected."""
    host = events.stream.header.hostname
    for device, spells in log.spells.items():
        streams = [each for each in own if each.stream.header.identity == device]
        said = _spells_text(spells, lambda at: extent.since_begin(at, events))
        named = _named(device)
        # A battery level may have been measured before the recording.
        due = [each for each in streams if not each.stream.header.may_be_older] or streams
        if any(each.stream.sample_count for each in due):
            level, text = Level.WARNING, f"{named} was {said}"
        elif any(each.stream.header.source_id in without for each in streams):
            level = Level.WARNING
            text = f"{named} was {said}, and was left out on purpose: it is not in the recording"
        else:
            level, text = Level.ERROR, f"{named} was {said}, and none of its data was recorded"
        yield Absence(Finding(level, "away", "", text), device, host, tuple(spells))


def _jumped(own: Sequence[Measured], events: Measured, extent: Extent) -> Iterator[Finding]:
    """Report when the timestamps of each recorded device were corrected by a jump."""
    for device, found in _of_recorded(own, events, EventKind.CLOCK_REANCHORED).items():
        # When a device restarts its clock, no sample is stamped before that is detected.
        sizes = {_time(each): finite(each.get("seconds")) for each in found}
        known = {at: size for at, size in sizes.items() if size is not None}
        if known:
            times = len(known)
            said = ", ".join(
                f"by {size:+.3f} s at {extent.since_begin(at, events):.1f} s"
                for at, size in list(known.items())[:_MOST_SPELLS]
            )
            more = f" and {times - _MOST_SPELLS} more times" if times > _MOST_SPELLS else ""
            text = (
                f"the timestamps of {_named(device)} jumped {said}{more}: those just before were "
                "wrong"
            )
            yield Finding(Level.WARNING, "clock-jumped", "", text)


def _silent(own: Sequence[Measured], events: Measured, extent: Extent) -> Iterator[Finding]:
    """Report when expected data of each recorded device did not arrive."""
    for device, found in _of_recorded(own, events, EventKind.STREAMS_SILENT).items():
        spans = [each for each in found if _number(each, "seconds") > 0]
        if spans:
            longest = max(spans, key=lambda each: _number(each, "seconds"))
            names = longest.get("streams")
            listed = cast("list[object]", names) if isinstance(names, list) else []
            streams = ", ".join(map(str, listed)) or "data"
            at = extent.since_begin(_time(longest), events)
            times = "once" if len(spans) == 1 else f"{len(spans)} times"
            text = (
                f"{_named(device)} was connected and sent nothing {times}, for {streams} "
                f"{_number(longest, 'seconds'):.1f} s until {at:.1f} s: data that came afterwards "
                "was delayed, or is counted as lost"
            )
            yield Finding(Level.WARNING, "silent", "", text)


def _refused(own: Sequence[Measured], events: Measured, extent: Extent) -> Iterator[Finding]:
    """Report what was refused or left out, of each recorded device and of the agent."""
    recorded = _recorded(own)
    sentences: dict[str, list[str]] = {_named(each): [] for each in recorded}
    for event in _events(events.stream.texts):
        for name, sentence, last_s in _problems(event):
            # What has passed is told of for some seconds.
            if extent.since_begin(last_s, events) >= 0:
                whose = [AGENT] if name == AGENT else map(_named, holders(name, recorded))
                for each in whose:
                    sentences.setdefault(each, []).append(sentence)
    for whose, told in sentences.items():
        # What is of no device names its stream.
        about = "" if whose == AGENT else f"{whose}: "
        for sentence in newest_of_each_kind(told):
            yield Finding(Level.WARNING, "refused", "", about + sentence)


def _problems(event: Mapping[str, Any]) -> Iterator[tuple[str, str, float]]:
    """Yield the problems in a heartbeat: name, sentence, and LSL time of the last occurrence."""
    of_all: object = event.get("problems")
    if event.get("event") != EventKind.HEARTBEAT or not isinstance(of_all, dict):
        return
    for device, of_one in cast("dict[str, object]", of_all).items():
        for told in cast("list[object]", of_one) if isinstance(of_one, list) else ():
            if isinstance(told, dict):
                problem = cast("dict[str, Any]", told)
                # Without a time it is the case at the heartbeat.
                last_s = _number(problem, "last") if "last" in problem else math.inf
                yield device, str(problem.get("what", "")), last_s


def _of_recorded(
    own: Sequence[Measured], events: Measured, kind: EventKind
) -> Mapping[DeviceIdentity, list[Mapping[str, Any]]]:
    """Return the events of one kind for the recorded devices."""
    recorded = _recorded(own)
    found: dict[DeviceIdentity, list[Mapping[str, Any]]] = {}
    for event in _events(events.stream.texts):
        device = _identity(event)
        if event.get("event") == kind and device in recorded:
            found.setdefault(device, []).append(event)
    return found


def _number(event: Mapping[str, Any], name: str) -> float:
    return finite(event.get(name)) or 0.0


def _named(device: DeviceIdentity) -> str:
    """Return the ``sensor/unit`` of a device, with its participant if known."""
    name = device_name(device)
    return f"{name} of {device.participant}" if device.participant else name


def _recorded(own: Sequence[Measured]) -> tuple[DeviceIdentity, ...]:
    found = (each.stream.header.identity for each in own)
    return tuple(dict.fromkeys(each for each in found if each is not None))


class Spell(NamedTuple):
    """A time in which a device did not send, in LSL seconds; None where an end is unknown."""

    how: str
    since: float | None
    until: float | None


@dataclass(slots=True)
class _AgentRun:
    """Consecutive heartbeats of one agent, by their LSL times in seconds."""

    started_s: float
    session: str
    since_s: float
    until_s: float


_MOST_REFUSED = 20


class EventLog:
    """The state of an agent, as known from its events so far."""

    def __init__(self) -> None:
        self._now: dict[DeviceIdentity, tuple[str, float | None]] = {}
        self._over: dict[DeviceIdentity, list[Spell]] = {}
        self._had: set[DeviceIdentity] = set()
        self._gone: dict[DeviceIdentity, float] = {}
        """Recorded devices that the agent has no longer, as after a restart, and since when."""
        self.refused: dict[str, list[str]] = {}
        """What was refused or left out since the first event, by device; see `_refused`."""
        self._first_s: float | None = None
        self._agents: list[_AgentRun] = []
        self._clock: tuple[float, float] | None = None

    @classmethod
    def of(cls, texts: Iterable[str], recorded: Sequence[DeviceIdentity]) -> EventLog:
        """Return the log of all events of a stream."""
        log = cls()
        log.take(texts, recorded)
        return log

    def take(self, texts: Iterable[str], recorded: Sequence[DeviceIdentity]) -> None:
        """Add the next events, in the order of the file.

        Parameters
        ----------
        recorded
            Devices of this agent that are recorded.
        """
        for event in _events(texts):
            self._first_s = _time(event) if self._first_s is None else self._first_s
            self._take_spells(event, recorded)
            if event.get("event") == EventKind.HEARTBEAT:
                self._take_heartbeat(event)
                self._take_gone(event, recorded)
                self._take_refused(event, recorded, self._first_s)

    @property
    def spells(self) -> Mapping[DeviceIdentity, list[Spell]]:
        """The times in which each recorded device did not send."""
        found = {device: [*spells] for device, spells in self._over.items()}
        for device, (how, since) in self._now.items():
            if how:
                found.setdefault(device, []).append(Spell(how, since, None))
        return found

    @property
    def spells_over(self) -> Mapping[DeviceIdentity, list[Spell]]:
        """Those of `spells` that have ended."""
        return self._over

    def other_agent_since(self, own_started_s: float | None = None) -> float | None:
        """Return since when, in LSL s, heartbeats are of another agent; None if they are not.

        An agent that was restarted after a crash started after its predecessor's last heartbeat.

        Parameters
        ----------
        own_started_s
            When the agent of this computer began, in LSL s; None if unknown.
        """
        before = None
        for run in self._agents:
            is_beside = before is not None and (
                run.started_s < before.until_s
                or (run.session and before.session and run.session != before.session)
            )
            is_not_ours = own_started_s is not None and run.started_s != own_started_s < run.until_s
            if is_beside or is_not_ours:
                return run.since_s
            before = run
        return None

    @property
    def gone(self) -> Mapping[DeviceIdentity, float]:
        """Devices that this agent (no other) no longer has, with the LSL time in s."""
        return {} if self.other_agent_since() is not None else self._gone

    @property
    def restarts(self) -> list[Spell]:
        """Restarts of this agent, each from its last heartbeat to the next one."""
        if self.other_agent_since() is not None:
            return []
        return [
            Spell("restarted", before.until_s, after.since_s)
            for before, after in pairwise(self._agents)
        ]

    def unix_s(self, lsl_s: float) -> float | None:
        """Return the Unix time of an LSL time of the agent, by its newest heartbeat."""
        return None if self._clock is None else self._clock[1] + lsl_s - self._clock[0]

    def _take_spells(self, event: Mapping[str, Any], recorded: Sequence[DeviceIdentity]) -> None:
        before_it = {device: how for device, (how, _) in self._now.items()}
        for device, how in _ways(event, before_it, recorded):
            before, since = self._now.get(device, ("", None))
            if device in self._now and how == before:
                continue
            # The first known state applies from the start of the recording.
            self._now[device] = how, _time(event) if device in self._now else None
            if before:
                self._over.setdefault(device, []).append(Spell(before, since, _time(event)))

    def _take_gone(self, event: Mapping[str, Any], recorded: Sequence[DeviceIdentity]) -> None:
        devices: object = event.get("devices")
        if not isinstance(devices, dict):
            return
        here = {
            each for name in cast("dict[str, object]", devices) for each in holders(name, recorded)
        }
        for device in self._had - here:
            self._gone.setdefault(device, _time(event))
        for device in here & self._gone.keys():
            del self._gone[device]
        self._had |= here

    def _take_refused(
        self, event: Mapping[str, Any], recorded: Sequence[DeviceIdentity], first_s: float
    ) -> None:
        for name, sentence, last_s in _problems(event):
            if last_s >= first_s:
                for each in [""] if name == AGENT else map(_named, holders(name, recorded)):
                    told = [*self.refused.get(each, ()), sentence]
                    self.refused[each] = newest_of_each_kind(told)[-_MOST_REFUSED:]

    def _take_heartbeat(self, event: Mapping[str, Any]) -> None:
        now_s, started_s = _time(event), _number(event, "agent_started")
        clock: object = event.get("clock")
        if isinstance(clock, dict):
            pair = cast("dict[str, Any]", clock)
            self._clock = _number(pair, "lsl_s"), _number(pair, "unix_ns") / 1e9
        if started_s <= 0.0:
            return
        session = str(event.get("session", ""))
        last = self._agents[-1] if self._agents else None
        if last is None or (last.started_s, last.session) != (started_s, session):
            self._agents.append(_AgentRun(started_s, session, now_s, now_s))
        else:
            last.until_s = now_s


def _ways(
    event: Mapping[str, Any],
    before: Mapping[DeviceIdentity, str],
    recorded: Sequence[DeviceIdentity],
) -> Iterator[tuple[DeviceIdentity, str]]:
    """Yield the kind of absence of each recorded device in an event; empty if it is present."""
    kind, devices = str(event.get("event")), event.get("devices")
    if kind == EventKind.HEARTBEAT and isinstance(devices, dict):
        for name, state in cast("dict[str, object]", devices).items():
            is_here = str(state) in CONNECTED
            how = "" if is_here else PAUSED if state == PAUSED else _NOT_CONNECTED
            yield from ((device, how) for device in holders(name, recorded))
        return
    device = _identity(event)
    if device not in recorded:
        return
    if kind == EventKind.PAUSED:
        yield device, PAUSED
    elif kind == EventKind.RESUMED:
        yield device, ""
    elif before.get(device) != PAUSED and kind in _LINK:
        yield device, _LINK[EventKind(kind)]


def _spells_text(spells: Sequence[Spell], since_begin: Callable[[float], float]) -> str:
    said = ", ".join(_spell(each, since_begin) for each in spells[:_MOST_SPELLS])
    more = len(spells) - _MOST_SPELLS
    return said + (f" and {more} more times" if more > 0 else "")


def _spell(spell: Spell, since_begin: Callable[[float], float]) -> str:
    def at(time: float) -> str:
        return f"{max(0.0, since_begin(time)):.1f} s"

    if spell.since is None and spell.until is None:
        return f"{spell.how} the whole time"
    since = "from the start" if spell.since is None else f"from {at(spell.since)}"
    until = "to the end" if spell.until is None else f"to {at(spell.until)}"
    return f"{spell.how} {since} {until}"


def _states(texts: Sequence[str]) -> Mapping[str, dict[str, None]]:
    """Return the states of each device by its name, in the order of the heartbeats."""
    found: dict[str, dict[str, None]] = {}
    for event in _events(texts):
        devices: object = event.get("devices")
        if event.get("event") == EventKind.HEARTBEAT and isinstance(devices, dict):
            for device, state in cast("dict[str, object]", devices).items():
                found.setdefault(device, {})[str(state)] = None
    return found


def _events(texts: Iterable[str]) -> Iterator[Mapping[str, Any]]:
    for text in texts:
        try:
            event: object = json.loads(text)
        except (ValueError, RecursionError):
            continue
        if isinstance(event, dict):
            yield cast("dict[str, Any]", event)


def _identity(event: Mapping[str, Any]) -> DeviceIdentity:
    names = (str(event.get(key, "")) for key in ("sensor", "unit", "participant", "label"))
    return DeviceIdentity(*names)


def _time(event: Mapping[str, Any]) -> float:
    return _number(event, "lsl_time")
