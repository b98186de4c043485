"""Every virtual device, the agent and a recorder, and faults that hit all devices at once."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any, NamedTuple, TypeVar

import numpy as np
from pylsl import local_clock

from biosensor_gateway.simulation.faults import FaultKind
from tests.faults.agent import AgentProcess
from tests.faults.expectations import (
    AT_ONCE,
    BATTERY,
    BATTERY_TOLERANCE,
    CELLS,
    OF_THE_AGENT,
    SENSORS,
    VALUES,
    WEAR,
    Channel,
    numeric_streams,
    regular_streams,
    source,
    steady_streams,
)
from tests.faults.matching import Slice, match, matched_times, missing
from tests.faults.recorder import Floats, Recorded, Recorder
from tests.rigs.lab_client import LabProcess, Samples

DEADLINE_S = 90.0
HOLD_S = 3.0
"""A fault that lasts goes on for so long after everybody has noticed it."""
_POLL_S = 0.1
_BEFORE_S = 2.0

_ItemT = TypeVar("_ItemT")

Cell = tuple[FaultKind, str]


class Account(NamedTuple):
    """Samples of a regular stream that never came, and those that were counted as lost."""

    missing: int
    lost: int


@dataclass
class Episode:
    """Some faults at once, on all devices that can have them.

    Attributes
    ----------
    begin_s, end_s
        LSL times: of the begin, and by cell of the end.
    log
        What the agent logged meanwhile.
    before, after
        The agent's status by sensor.
    seen
        Cells that the agent has noticed.
    recovered_s
        By cell, how long after the end it was as before.
    """

    kinds: tuple[FaultKind, ...]
    begin_s: float
    before: Mapping[str, Any]
    after: Mapping[str, Any] = field(default_factory=dict[str, Any])
    end_s: dict[Cell, float] = field(default_factory=dict[Cell, float])
    log: Sequence[Mapping[str, Any]] = ()
    seen: set[Cell] = field(default_factory=set[Cell])
    recovered_s: dict[Cell, float] = field(default_factory=dict[Cell, float])
    received: dict[tuple[str, str], Recorded] = field(
        default_factory=dict[tuple[str, str], Recorded]
    )
    truth: dict[tuple[str, str], Samples] = field(default_factory=dict[tuple[str, str], Samples])

    @property
    def cells(self) -> list[Cell]:
        """Which kind hits which sensor."""
        return [(kind, name) for kind, name in CELLS if kind in self.kinds]

    def warnings(self, name: str) -> list[Mapping[str, Any]]:
        """What was said about one device that a person should know."""
        return [
            record
            for record in self.log
            if record.get("sensor") == name and record["level"] in ("warning", "error")
        ]

    def slices(self, name: str, data_name: str) -> list[Slice]:
        """Match what was received of one stream against the truth."""
        return match(self.received[name, data_name], self.truth[name, data_name])

    def measured_s(self, name: str, data_name: str) -> Floats:
        """When what was received of one stream was measured."""
        return matched_times(self.slices(name, data_name), self.truth[name, data_name])

    def account(self, name: str, data_name: str) -> Account:
        """Balance one stream."""
        absent = missing(self.measured_s(name, data_name), self.truth[name, data_name])
        lost = [
            status[name]["streams"][source(name, data_name)]["lost"]
            for status in (self.before, self.after)
        ]
        return Account(absent, lost[1] - lost[0])


class Bench:
    """Steers the lab and looks at what agent and recorder have.

    Parameters
    ----------
    lab, agent, recorder
        Running.
    """

    def __init__(self, lab: LabProcess, agent: AgentProcess, recorder: Recorder) -> None:
        self.lab = lab
        self.agent = agent
        self.recorder = recorder
        self._episodes: dict[FaultKind, Episode] = {}

    def wait_for_streams(self) -> None:
        """Wait until every steady stream of every sensor flows."""
        begin_s = local_clock()
        silent = _wait(SENSORS, lambda name: self._streams_since(name, begin_s))
        assert not silent, f"no samples of {silent}: {self.agent.console()}"

    def episode(self, kinds: tuple[FaultKind, ...]) -> Episode:
        """Return what these faults did; they are made at the first call."""
        if kinds[0] not in self._episodes:
            self._episodes |= dict.fromkeys(kinds, self._run(kinds))
        return self._episodes[kinds[0]]

    def _run(self, kinds: tuple[FaultKind, ...]) -> Episode:
        self.wait_for_streams()
        logged = len(self.agent.log())
        episode = Episode(kinds, local_clock(), self.agent.status())
        for kind, name in episode.cells:
            self.lab.apply(name, kind.value, VALUES.get(kind, inf))
            episode.end_s[kind, name] = local_clock()

        def notices(cell: Cell) -> bool:
            episode.log = self.agent.log()[logged:]
            return self._is_seen(episode, *cell)

        unseen = _wait(episode.cells, notices)
        episode.seen = set(episode.cells) - set(unseen)
        time.sleep(HOLD_S)
        self._end(episode)
        self._await_recovery(episode)
        self._settle(episode)
        episode.log = self.agent.log()[logged:]
        return episode

    def _end(self, episode: Episode) -> None:
        for kind, name in episode.cells:
            # A device that answers late is to be got going all the same.
            if kind not in AT_ONCE and kind is not FaultKind.LATE:
                episode.end_s[kind, name] = local_clock()
                self.lab.clear(name, kind.value)

    def _await_recovery(self, episode: Episode) -> None:
        def recovers(cell: Cell) -> bool:
            recovered_s = self._recovered(*cell, episode.end_s[cell])
            if recovered_s is not None:
                episode.recovered_s[cell] = recovered_s - episode.end_s[cell]
            return recovered_s is not None

        _wait(episode.cells, recovers)
        for kind, name in episode.cells:
            if kind is FaultKind.LATE:
                self.lab.clear(name, kind.value)

    def _settle(self, episode: Episode) -> None:
        """Wait until the books are balanced: some losses are known only when a window closes."""

        def balances(name: str) -> bool:
            self._take_stock(episode, name)
            return True

        _wait(SENSORS, balances)

    def _take_stock(self, episode: Episode, name: str) -> None:
        """Status first, then what arrived, then the truth: each knows all that the one before."""
        status = self.agent.status()
        since_s = episode.begin_s - _BEFORE_S
        for data_name in numeric_streams(name):
            received = self.recorder.recorded(source(name, data_name)).since(since_s)
            episode.received[name, data_name] = received
        for data_name, samples in self.lab.truth(name).items():
            recent = samples.times >= since_s - _BEFORE_S
            episode.truth[name, data_name] = Samples(samples.times[recent], samples.values[recent])
        episode.after = {**episode.after, name: status[name]}

    def _is_seen(self, episode: Episode, kind: FaultKind, name: str) -> bool:
        status = self.agent.status()[name]
        match kind:
            case FaultKind.GARBAGE:
                return status["dropped_bytes"] > episode.before[name]["dropped_bytes"]
            case FaultKind.LOW_BATTERY:
                levels = self._values(name, BATTERY[name], episode.begin_s)
                return bool((np.abs(levels - VALUES[kind]) <= BATTERY_TOLERANCE).any())
            case FaultKind.OFF_BODY:
                wear = WEAR[name]
                return bool((self._values(name, wear, episode.begin_s) == wear.off).any())
            case FaultKind.DRIFT:
                clock = status["clock"]
                # A fast device gains on us, so that its seconds have to be shortened.
                return clock is None or clock["drift_ppm"] < -VALUES[kind] / 2
            case FaultKind.REFUSE:
                return any("refuse" in record["event"] for record in episode.warnings(name))
            case _:
                return bool(episode.warnings(name))

    def _recovered(self, kind: FaultKind, name: str, end_s: float) -> float | None:
        """When the first sample came that shows it, None as long as not all streams go on."""
        if kind is FaultKind.OFF_BODY:
            wear = WEAR[name]
            recorded = self.recorder.recorded(source(name, wear.data_name)).since(end_s)
            worn = recorded.values[:, wear.index] != wear.off
            return float(recorded.arrivals[worn].min()) if worn.any() else None
        if not self._streams_since(name, end_s):
            return None
        return min(
            float(self.recorder.recorded(source(name, each)).since(end_s).arrivals[0])
            for each in steady_streams(name)
        )

    def _streams_since(self, name: str, begin_s: float) -> bool:
        newest = (self.recorder.newest(source(name, each)) for each in steady_streams(name))
        return all(stamp > begin_s for stamp in newest)

    def _values(self, name: str, channel: Channel, since_s: float) -> Floats:
        recorded = self.recorder.recorded(source(name, channel.data_name)).since(since_s)
        return recorded.values[:, channel.index] if len(recorded.times) else np.empty(0)


def _wait(items: Iterable[_ItemT], condition: Callable[[_ItemT], bool]) -> list[_ItemT]:
    """Wait until a condition holds for every item; return those for which it never did."""
    left = list(items)
    deadline = time.monotonic() + DEADLINE_S
    while left and time.monotonic() < deadline:
        time.sleep(_POLL_S)
        left = [item for item in left if not condition(item)]
    return left
