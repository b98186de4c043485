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
from biosensor_gateway.recording.xdf.figures import Gap, Gaps, seconds_text
from biosensor_gateway.recording.xdf.findings import CLOCK_SET_S, Finding, Level
from biosensor_gateway.recording.xdf.header import RecordedHeader
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
# The most that a time service slews a clock, in s per s.
_MOST_SLEW = 1e-3
_EDGE_S = 3.0
"""A device's last packet before a pause comes a while later, and after it 1 s is left out."""


def tells_devices(recording: Recording) -> bool:
    """Whether a recording contains an agent's list of devices."""
    events = (each.texts for each in recording.streams if each.header.is_events)
    return any(EventLog.of(each, ()).states for each in events)


@dataclass(frozen=True, slots=True)
class _Agent:
    """One agent in a recording: its events, what they tell, and the streams of its computer."""

    events: Measured
    own: list[Measured]
    log: EventLog
    extent: Extent

    def at(self, stamp: float) -> float:
        """Convert a time of its events to seconds since the start of the recording."""
        return self.extent.since_begin(stamp, self.events)


def _agents(streams: Sequence[Measured], extent: Extent) -> Iterator[_Agent]:
    for events in streams:
        if events.stream.header.is_events:
            own = [each for each in streams if _is_beside(each, events)]
            found = (each.stream.header.identity for each in own)
            recorded = tuple(dict.fromkeys(each for each in found if each is not None))
            begin_s = -extent.since_begin(0.0, events)
            log = EventLog.of(events.stream.texts, recorded, begin_s)
            yield _Agent(events, own, log, extent)


def judge_devices(streams: Sequence[Measured], extent: Extent) -> Iterator[Finding]:
    """Report devices of an agent that were not recorded, or not until the end."""
    for agent in _agents(streams, extent):
        rules = (_another_agent, _left_out, _removed, _clock_set, _jumped, _silent, _refused)
        for rule in rules:
            yield from rule(agent)


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
    return [
        absence
        for agent in _agents(streams, extent)
        for absence in (*_restarted(agent), *_away(agent, without))
    ]


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
        begin = measured.own_s(extent.begin)
        return [Gap(begin, extent.length_s, 0)] * (code == "no-samples")
    late_s = extent.since_begin(figures.first, measured)
    if code == "begins-late":
        return [Gap(figures.first - late_s, late_s, 0)]
    early_s = extent.length_s - extent.since_begin(figures.last, measured)
    return [Gap(figures.last, early_s, 0)] * (code == "ends-early")


def without_pauses(streams: Sequence[Measured], extent: Extent) -> list[Measured]:
    """Remove the gaps during pauses of the device from each stream's gaps."""
    pauses: dict[str, list[Spell]] = {}
    for agent in _agents(streams, extent):
        spells = agent.log.spells
        for each in agent.own:
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


def _another_agent(agent: _Agent) -> Iterator[Finding]:
    """Report that the recorder continued with the stream of another agent."""
    since_s = agent.log.other_agent_since()
    if since_s is not None:
        text = f"from {agent.at(since_s):.1f} s on {OF_ANOTHER_AGENT}"
        yield Finding(Level.ERROR, "another-agent", agent.events.name, text)


def _left_out(agent: _Agent) -> Iterator[Finding]:
    is_counted = any(each.stream.header.is_counters for each in agent.own)
    for device, states in agent.log.states.items():
        if holders(device, agent.log.recorded):
            continue
        if not CONNECTED & states.keys():
            how = ", ".join(STATE_WORDS.get(each, each) for each in states)
            text = f"{device} was never available ({how}), so none of its data was recorded"
            yield Finding(Level.WARNING, "absent", "", text)
        elif not is_counted:
            # Otherwise each missing stream is reported by name.
            text = f"the agent also had {device}, from which nothing was recorded"
            yield Finding(Level.ERROR, "left-out", "", text)


def _removed(agent: _Agent) -> Iterator[Finding]:
    gone = {**agent.log.gone, **agent.log.removed}
    for identity, at in sorted(gone.items(), key=lambda each: each[1]):
        text = (
            f"{_named(identity)} was removed or renamed in the settings at "
            f"{agent.at(at):.1f} s, and none of its data was recorded since"
        )
        yield Finding(Level.ERROR, "removed", "", text)


def _restarted(agent: _Agent) -> Iterator[Absence]:
    """Report restarts of the agent, each between two heartbeats."""
    spells = tuple(agent.log.restarts)
    if spells:
        said = ", ".join(
            f"between {agent.at(each.since or 0.0):.1f} s and {agent.at(each.until or 0.0):.1f} s"
            for each in spells[:_MOST_SPELLS]
        )
        text = f"the agent was restarted {said}{_more(spells)}"
        host = agent.events.stream.header.hostname
        yield Absence(Finding(Level.WARNING, "restarted", "", text), None, host, spells)


def _away(agent: _Agent, without: Collection[str]) -> Iterator[Absence]:
    """Report when each recorded device was paused or not connected."""
    host = agent.events.stream.header.hostname
    for device, spells in agent.log.spells.items():
        streams = [each for each in agent.own if each.stream.header.identity == device]
        was = f"{_named(device)} was {_spells_text(spells, agent.at)}"
        # A battery level may have been measured before the recording.
        due = [each for each in streams if not each.stream.header.may_be_older] or streams
        if any(each.stream.sample_count for each in due):
            finding = Finding(Level.WARNING, "away", "", was)
        elif any(each.stream.header.source_id in without for each in streams):
            text = f"{was}, and was left out on purpose: it is not in the recording"
            finding = Finding(Level.WARNING, "away", "", text)
        else:
            finding = Finding(Level.ERROR, "away", "", f"{was}, and none of its data was recorded")
        yield Absence(finding, device, host, tuple(spells))


def clock_steps_s(streams: Sequence[Measured]) -> list[float]:
    """Return the sizes of the steps of the clocks of agents' computers."""
    texts = (each.stream.texts for each in streams if each.stream.header.is_events)
    return [step.by_s for each in texts for step in EventLog.of(each, ()).clock_steps]


def clock_set_text(by_s: float) -> str:
    """Return what a step of a computer's time of day against its LSL clock, in s, means."""
    by = seconds_text(abs(by_s), 1)
    if by_s < 0:
        return f"its clock was set back by {by}, so that times of day in exports jump"
    return (
        f"it slept for {by}, or its clock was set forward by that: if it slept, data is missing "
        "without a gap in the timestamps"
    )


def _clock_set(agent: _Agent) -> Iterator[Finding]:
    """Report that the computer of the agent slept, or that its clock was set."""
    for each in agent.log.clock_steps:
        host = agent.events.stream.header.hostname or "the agent's computer"
        between = f"between {agent.at(each.since_s):.1f} s and {agent.at(each.until_s):.1f} s"
        text = f"{host}: {between} {clock_set_text(each.by_s)}"
        yield Finding(Level.WARNING, "clock-set", "", text)


def _jumped(agent: _Agent) -> Iterator[Finding]:
    """Report when the timestamps of each recorded device were corrected by a jump."""
    for device, found in agent.log.noted[EventKind.CLOCK_REANCHORED].items():
        # When a device restarts its clock, no sample is stamped before that is detected.
        sizes = {_time(each): finite(each.get("seconds")) for each in found}
        known = [(at, size) for at, size in sizes.items() if size is not None]
        if known:
            said = ", ".join(
                f"by {size:+.3f} s at {agent.at(at):.1f} s" for at, size in known[:_MOST_SPELLS]
            )
            text = (
                f"the timestamps of {_named(device)} jumped {said}{_more(known)}: those just "
                "before were wrong"
            )
            yield Finding(Level.WARNING, "clock-jumped", "", text)


def _silent(agent: _Agent) -> Iterator[Finding]:
    """Report when expected data of each recorded device did not arrive."""
    for device, found in agent.log.noted[EventKind.STREAMS_SILENT].items():
        spans = [each for each in found if _number(each, "seconds") > 0]
        if spans:
            longest = max(spans, key=lambda each: _number(each, "seconds"))
            names = longest.get("streams")
            listed = cast("list[object]", names) if isinstance(names, list) else []
            streams = ", ".join(map(str, listed)) or "data"
            times = "once" if len(spans) == 1 else f"{len(spans)} times"
            text = (
                f"{_named(device)} was connected and sent nothing {times}, for {streams} "
                f"{_number(longest, 'seconds'):.1f} s until {agent.at(_time(longest)):.1f} s: data "
                "that came afterwards was delayed, or is counted as lost"
            )
            yield Finding(Level.WARNING, "silent", "", text)


def _refused(agent: _Agent) -> Iterator[Finding]:
    """Report what was refused or left out, of each recorded device and of the agent."""
    # What is of no device names its stream.
    for whose in (*map(_named, agent.log.recorded), ""):
        about = f"{whose}: " if whose else ""
        for sentence in agent.log.refused.get(whose, ()):
            yield Finding(Level.WARNING, "refused", "", about + sentence)


def _more(several: Sequence[object]) -> str:
    more = len(several) - _MOST_SPELLS
    return f" and {more} more times" if more > 0 else ""


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


def _number(event: Mapping[str, Any], name: str) -> float:
    return finite(event.get(name)) or 0.0


def _named(device: DeviceIdentity) -> str:
    """Return the ``sensor/unit`` of a device, with its participant if known."""
    name = device_name(device)
    return f"{name} of {device.participant}" if device.participant else name


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


class ClockStep(NamedTuple):
    """A step of the time of day against the LSL clock, between two heartbeats in LSL seconds."""

    since_s: float
    until_s: float
    by_s: float


class EventLog:
    """The state of an agent, as known from its events so far."""

    def __init__(self, begin_s: float | None = None) -> None:
        # Devices of this agent that are recorded.
        self.recorded: Sequence[DeviceIdentity] = ()
        # The states of each device by its name, in the order of the heartbeats.
        self.states: dict[str, dict[str, None]] = {}
        # Recorded devices that were removed from the settings and not added again, and when.
        self.removed: dict[DeviceIdentity, float] = {}
        # Events of some kinds, for the recorded devices.
        self.noted: dict[EventKind, dict[DeviceIdentity, list[Mapping[str, Any]]]] = {
            EventKind.CLOCK_REANCHORED: {},
            EventKind.STREAMS_SILENT: {},
        }
        self._now: dict[DeviceIdentity, tuple[str, float | None]] = {}
        self._over: dict[DeviceIdentity, list[Spell]] = {}
        self._had: set[DeviceIdentity] = set()
        self._gone: dict[DeviceIdentity, float] = {}
        """Recorded devices that the agent has no longer, as after a restart, and since when."""
        self.refused: dict[str, list[str]] = {}
        """What was refused or left out since the start, by device; empty for the agent itself."""
        # On the clock of the events; the first event if it is unknown.
        self._begin_s = begin_s
        self._agents: list[_AgentRun] = []
        self._clock: tuple[float, float] | None = None
        self.clock_steps: list[ClockStep] = []

    @classmethod
    def of(
        cls,
        texts: Iterable[str],
        recorded: Sequence[DeviceIdentity],
        begin_s: float | None = None,
    ) -> EventLog:
        """Return the log of all events of a stream."""
        log = cls(begin_s)
        log.take(texts, recorded)
        return log

    def take(self, texts: Iterable[str], recorded: Sequence[DeviceIdentity]) -> None:
        """Add the next events, in the order of the file.

        Parameters
        ----------
        recorded
            Devices of this agent that are recorded.
        """
        self.recorded = recorded
        for event in _events(texts):
            self._begin_s = _time(event) if self._begin_s is None else self._begin_s
            self._take_spells(event, recorded)
            if event.get("event") == EventKind.HEARTBEAT:
                self._take_heartbeat(event)
                self._take_gone(event, recorded)
                self._take_refused(event, recorded, self._begin_s)
            elif (device := _identity(event)) in recorded:
                self._take_of_device(event, device)

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

    def _take_of_device(self, event: Mapping[str, Any], device: DeviceIdentity) -> None:
        kind = str(event.get("event"))
        if kind == EventKind.DEVICE_REMOVED:
            self.removed[device] = _time(event)
        elif kind == EventKind.DEVICE_ADDED:
            # A device added again under the same name is recorded again.
            self.removed.pop(device, None)
        elif kind in self.noted:
            self.noted[EventKind(kind)].setdefault(device, []).append(event)

    def _take_gone(self, event: Mapping[str, Any], recorded: Sequence[DeviceIdentity]) -> None:
        devices: object = event.get("devices")
        if not isinstance(devices, dict):
            return
        states = cast("dict[str, object]", devices)
        for name, state in states.items():
            self.states.setdefault(name, {})[str(state)] = None
        here = {each for name in states for each in holders(name, recorded)}
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
            self._take_clock(_number(pair, "lsl_s"), _number(pair, "unix_ns") / 1e9, started_s)
        if started_s <= 0.0:
            return
        session = str(event.get("session", ""))
        last = self._agents[-1] if self._agents else None
        if last is None or (last.started_s, last.session) != (started_s, session):
            self._agents.append(_AgentRun(started_s, session, now_s, now_s))
        else:
            last.until_s = now_s

    def _take_clock(self, lsl_s: float, unix_s: float, started_s: float) -> None:
        # Another agent may be on a computer that was restarted, and its LSL clock with it.
        if self._clock is not None and self._agents and self._agents[-1].started_s == started_s:
            passed_s = lsl_s - self._clock[0]
            step = ClockStep(self._clock[0], lsl_s, unix_s - self._clock[1] - passed_s)
            if passed_s > 0 and abs(step.by_s) > max(CLOCK_SET_S, _MOST_SLEW * passed_s):
                self.clock_steps.append(step)
        self._clock = lsl_s, unix_s


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
    return said + _more(spells)


def _spell(spell: Spell, since_begin: Callable[[float], float]) -> str:
    def at(time: float) -> str:
        return f"{max(0.0, since_begin(time)):.1f} s"

    if spell.since is None and spell.until is None:
        return f"{spell.how} the whole time"
    since = "from the start" if spell.since is None else f"from {at(spell.since)}"
    until = "to the end" if spell.until is None else f"to {at(spell.until)}"
    return f"{spell.how} {since} {until}"


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
