"""Every virtual device, the agent and a recorder, and faults that hit all devices at once."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from math import inf
from typing import Any, TypeVar

import numpy as np
from pylsl import local_clock

from biosensor_gateway.simulation.faults import FaultKind
from tests.faults.agent import AgentProcess
from tests.faults.episode import Cell, Episode, Stock
from tests.faults.expectations import (
    AT_ONCE,
    BATTERY_TOLERANCE,
    TOGETHER,
    VALUES,
    AgentFault,
    Kind,
    battery_of,
    contact_of,
    numeric_streams,
    regular_streams,
    source,
    steady_streams,
)
from tests.faults.matching import UnknownSampleError
from tests.faults.recorder import Floats, Recorder
from tests.faults.scenarios.figures import is_long
from tests.faults.table import FaultTable, Row
from tests.rigs.lab_client import LabProcess, Samples

DEADLINE_S = 90.0
"""Some devices are asked for their battery once a minute only."""
SETTLE_S = 10.0
"""Stamps are promised from so long after a start on, and the fault before may have been one."""
HOLD_S = 3.0
"""A fault that lasts goes on for so long after everybody has noticed it."""
_POLL_S = 0.1
SLEEP_S, LONG_SLEEP_S = 15.0, 60.0
"""A BioHarness gives a host up that is silent for 10 s."""
EARLIER_S = 10.0
"""What was on its way when the agent fell asleep may have the time at which it was read: a frame
of pulse intervals holds those of 5 s."""

_ItemT = TypeVar("_ItemT")


class FaultBench:
    """Steers the lab, and looks at what agent and recorder have.

    Parameters
    ----------
    lab, agent, recorder
        Running.
    table
        Gets the times to recover.
    """

    def __init__(
        self, lab: LabProcess, agent: AgentProcess, recorder: Recorder, table: FaultTable
    ) -> None:
        self.lab = lab
        self.sensors = tuple(lab.settings)
        self.agent = agent
        self.recorder = recorder
        self._table = table
        self._episodes: dict[Kind, Episode] = {}
        self._stock: dict[str, Stock] = {}

    def wait_for_streams(self) -> None:
        """Wait until everything streams that never pauses."""
        begin_s = local_clock()
        silent = _wait(self.sensors, lambda name: self._streams_since(name, begin_s))
        assert not silent, f"no samples of {silent}: {self.agent.console()}"
        # It says so once a second only.
        _wait(self.sensors, lambda name: self._status(name)["streams"])

    def episode(self, kind: Kind) -> Episode:
        """Return what a fault did; it is made at the first call."""
        if kind not in self._episodes:
            kinds: tuple[Kind, ...] = TOGETHER if kind in TOGETHER else (kind,)
            self._episodes |= dict.fromkeys(kinds, self._run(kinds))
        return self._episodes[kind]

    def _run(self, kinds: tuple[Kind, ...]) -> Episode:
        if FaultKind.DRIFT in kinds:
            time.sleep(SETTLE_S)
        if not self._stock or FaultKind.DRIFT in kinds:
            self._stock = {name: Stock(local_clock(), self._status(name)) for name in self.sensors}
        self.wait_for_streams()
        logged = len(self.agent.log())
        episode = Episode(kinds, local_clock(), dict(self._stock))
        self._begin(episode)

        def is_noticed(cell: Cell) -> bool:
            episode.log = self.agent.log()[logged:]
            noticed = self._is_noticed(episode, *cell)
            if noticed and cell[0] is FaultKind.FORGET:
                # What came before was on its way when the device forgot.
                episode.end_s[cell] = local_clock()
            return noticed

        episode.seen = set(episode.cells) - set(_wait(episode.cells, is_noticed))
        time.sleep(HOLD_S)
        self._end(episode)
        self._await_recovery(episode)
        recovered_s = local_clock()
        # Some losses are known only when a window closes.
        _wait(self.sensors, lambda name: self._balances(episode, name, recovered_s))
        episode.log = self.agent.log()[logged:]
        self._report(episode)
        return episode

    def _begin(self, episode: Episode) -> None:
        if AgentFault.ASLEEP in episode.kinds:
            self.agent.sleep(LONG_SLEEP_S if is_long() else SLEEP_S)
            _wait(self.sensors, lambda name: name in self.agent.status())
        for kind, name in episode.cells:
            if isinstance(kind, FaultKind):
                self.lab.apply(name, kind.value, VALUES.get(kind, inf))
            episode.end_s[kind, name] = local_clock()

    def _end(self, episode: Episode) -> None:
        for kind, name in episode.cells:
            # A device that answers late has to be got going all the same.
            if isinstance(kind, FaultKind) and kind not in AT_ONCE | {FaultKind.LATE}:
                episode.end_s[kind, name] = local_clock()
                self.lab.clear(name, kind.value)

    def _await_recovery(self, episode: Episode) -> None:
        def recovers(cell: Cell) -> bool:
            recovered_s = self._recovered(*cell, episode.end_s[cell])
            if recovered_s is not None:
                is_forgetful = cell[0] is FaultKind.FORGET
                begin_s = episode.begin_s if is_forgetful else episode.end_s[cell]
                episode.recovered_s[cell] = recovered_s - begin_s
            return recovered_s is not None

        _wait(episode.cells, recovers)
        for kind, name in episode.cells:
            if kind is FaultKind.LATE:
                self.lab.clear(name, kind.value)

    def _balances(self, episode: Episode, name: str, recovered_s: float) -> bool:
        """Take stock of one device: status, samples, truth, each after what it explains."""
        since_s = episode.before[name].time_s
        self._stock[name] = episode.after[name] = Stock(local_clock(), self._status(name))
        for data_name in numeric_streams(name):
            received = self.recorder.recorded(source(name, data_name)).since(since_s)
            episode.received[name, data_name] = received
        for data_name, (times, values) in self.lab.truth(name).items():
            recent = times >= since_s - EARLIER_S
            episode.truth[name, data_name] = Samples(times[recent], values[recent])
        status = episode.after[name].status
        is_new = max(each["last_stamp"] for each in status["streams"].values()) > recovered_s
        # Some streams may be enabled again when others flow already.
        return is_new and _says_well(status) and episode.is_balanced(name)

    def _is_noticed(self, episode: Episode, kind: Kind, name: str) -> bool:
        status = self._status(name)
        match kind:
            case FaultKind.GARBAGE:
                before = episode.before[name].status
                return status["dropped_bytes"] > before["dropped_bytes"]
            case FaultKind.LOW_BATTERY:
                levels = self._values(name, *battery_of(name), episode.begin_s)
                return bool((np.abs(levels - VALUES[kind]) <= BATTERY_TOLERANCE).any())
            case FaultKind.OFF_BODY:
                data_name, channel, off = contact_of(name)
                return bool((self._values(name, data_name, channel, episode.begin_s) == off).any())
            case FaultKind.DRIFT:
                clock = status["clock"]
                # The seconds of a fast device are too short. The line follows two minutes, of
                # which at the deadline the most recent part only is of the new rate.
                return clock is None or clock["drift_ppm"] < -VALUES[kind] / 4
            case AgentFault.ASLEEP | FaultKind.UNREADABLE:
                return self._is_well(name) == (kind is AgentFault.ASLEEP)
            case _:
                word = "refuse" if kind is FaultKind.REFUSE else ""
                return any(word in record["event"] for record in episode.warnings(name))

    def _recovered(self, kind: Kind, name: str, end_s: float) -> float | None:
        """When the first sample came that shows it; None as long as something is missing."""
        if kind is FaultKind.OFF_BODY:
            contact = contact_of(name)
            recorded = self.recorder.recorded(source(name, contact.data_name)).since(end_s)
            worn = recorded.values[:, contact.channel] != contact.off
            return float(recorded.arrivals[worn].min()) if worn.any() else None
        is_silent = not self._streams_since(name, end_s)
        # What comes more rarely than the steady streams could not be read, either.
        if is_silent or (kind is FaultKind.UNREADABLE and not self._is_well(name)):
            return None
        return min(
            float(self.recorder.recorded(source(name, each)).since(end_s).arrivals[0])
            for each in steady_streams(name)
        )

    def _status(self, name: str) -> Mapping[str, Any]:
        return self.agent.devices()[name]

    def _is_well(self, name: str) -> bool:
        return _says_well(self._status(name))

    def _streams_since(self, name: str, begin_s: float) -> bool:
        newest = (self.recorder.newest(source(name, each)) for each in steady_streams(name))
        return all(stamp > begin_s for stamp in newest)

    def _values(self, name: str, data_name: str, channel: int, since_s: float) -> Floats:
        recorded = self.recorder.recorded(source(name, data_name)).since(since_s)
        return recorded.values[:, channel]

    def _report(self, episode: Episode) -> None:
        for kind, name in episode.cells:
            recovered_s = episode.recovered_s.get((kind, name))
            accounts: dict[str, dict[str, int]] = {}
            # Of samples from nowhere there are no books; a test says so.
            with suppress(UnknownSampleError):
                for data_name in regular_streams(name):
                    accounts[data_name] = episode.account(name, data_name)._asdict()
            self._table.add(Row(name, kind.value, recovered_s, accounts))


def _says_well(status: Mapping[str, Any]) -> bool:
    return status["state"] == "streaming" and status["error"] is None


def _wait(items: Iterable[_ItemT], condition: Callable[[_ItemT], bool]) -> list[_ItemT]:
    """Wait until a condition has held for every item; return those for which it never did."""
    left = list(items)
    deadline = time.monotonic() + DEADLINE_S
    while left and time.monotonic() < deadline:
        time.sleep(_POLL_S)
        left = [item for item in left if not condition(item)]
    return left
