"""Samples on their way: measured in time, written to whoever subscribed, noted as truth."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import floor, nan
from typing import Any, cast

import numpy as np

from biosensor_gateway.devices.emotiv_insight.declaration import SPEC
from biosensor_gateway.devices.emotiv_insight.simulator.listener import Client
from biosensor_gateway.devices.emotiv_insight.simulator.release import Columns
from biosensor_gateway.devices.emotiv_insight.simulator.sessions import Session
from biosensor_gateway.devices.emotiv_insight.simulator.signals import Sample, Signal
from biosensor_gateway.simulation.crystal import Crystal
from biosensor_gateway.simulation.truth import Truth

_AHEAD_S = 0.25
_TRUE_OF = {"eeg": ("eeg", "eeg_status"), "mot": ("mot", "gyro")}
_LABELS = {stream.data_name: stream.labels for stream in SPEC.streams}
_DECLARED_AS = {
    "eng": "engagement",
    "exc": "excitement",
    "lex": "long_term_excitement",
    "str": "stress",
    "rel": "relaxation",
    "int": "interest",
    "foc": "focus",
    "GYROX": "X",
    "GYROY": "Y",
    "GYROZ": "Z",
}


@dataclass(slots=True)
class Mishaps:
    """What befalls the next EEG samples; the numbers count down.

    Attributes
    ----------
    unannounced
        Samples of every stream have a column that no subscription told of.
    lost
        Are not sent.
    interpolated
        Are marked as filled in.
    repeated
        Are sent twice.
    markers
        Objects that go with one sample each.
    """

    unannounced: bool = False
    lost: int = 0
    interpolated: int = 0
    repeated: int = 0
    markers: deque[dict[str, Any]] = field(default_factory=deque[dict[str, Any]])

    def lose(self, count: int) -> None:
        """Send none of the next samples."""
        self.lost += count

    def interpolate(self, count: int) -> None:
        """Mark the next samples as filled in."""
        self.interpolated += count

    def repeat(self, count: int) -> None:
        """Send each of the next samples twice."""
        self.repeated += count

    def mark(self, label: str, value: int) -> None:
        """Put a marker into the next sample."""
        self.markers.append(
            {"extras": {}, "isStop": False, "label": label, "port": "Software",
             "type": "instance", "value": value}
        )  # fmt: skip

    def alter(self, sample: Sample) -> Sample:
        """Mark a sample as it has to be."""
        if self.interpolated:
            self.interpolated -= 1
            sample = sample | {"INTERPOLATED": 1}
        if self.markers:
            sample = sample | {"MARKER_HARDWARE": 1, "MARKERS": [self.markers.popleft()]}
        return sample

    def loses(self) -> bool:
        """Tell whether the next sample gets lost."""
        lost = self.lost > 0
        self.lost -= lost
        return lost

    def copies(self) -> int:
        """How many times the next sample is sent."""
        repeated = self.repeated > 0
        self.repeated -= repeated
        return 1 + repeated


@dataclass(frozen=True, slots=True)
class Stage:
    """What a stream depends on.

    Attributes
    ----------
    crystal
        Gives sample ``k`` the device time ``k / rate``.
    begin_s
        LSL time at which the wearer's time is 0.
    jitter_s
        Bound of the delay on the way.
    rng
        Of the delays.
    delivers
        Whether the headset's data reach Cortex.
    subscribed
        Who gets a stream.
    is_due
        Whether a session gets the sample of this number and stream.
    stamp
        Time on the clock of Cortex [unix s] at a device time [s].
    changes
        Counts what makes samples that were computed ahead wrong.
    """

    crystal: Crystal
    begin_s: float
    jitter_s: float
    rng: np.random.Generator
    truth: Truth
    delivers: Callable[[], bool]
    subscribed: Callable[[str], list[tuple[Session, Client]]]
    is_due: Callable[[Session, str, int], bool]
    stamp: Callable[[float], float]
    changes: Callable[[], int]


class Stream:
    """One data stream of the headset.

    Parameters
    ----------
    mishaps
        All but ``unannounced`` for EEG only.
    """

    def __init__(
        self,
        name: str,
        rate: float,
        signal: Signal,
        columns: Columns,
        mishaps: Mishaps,
        stage: Stage,
    ) -> None:
        self._name = name
        self._rate = rate
        self._signal = signal
        self._columns = columns
        self._mishaps = mishaps
        self._stage = stage
        self._is_wanted = asyncio.Event()
        self._true_columns = _declared(columns)
        self._true_names = tuple(
            data_name
            for data_name in _TRUE_OF.get(name, (name,))
            if set(_LABELS.get(data_name, ())) & self._true_columns.keys()
        )

    def wake(self) -> None:
        """Look for subscribers."""
        self._is_wanted.set()

    async def run(self) -> None:
        """Deliver for ever; sleep while nobody is subscribed."""
        while True:
            await self._is_wanted.wait()
            self._is_wanted.clear()
            number = floor(self._stage.crystal.now() * self._rate) + 1
            while self._stage.subscribed(self._name):
                number = await self._run_block(number)

    async def _run_block(self, number: int) -> int:
        """Measure a block ahead of time, deliver each sample in time; return the next number."""
        stage = self._stage
        changes = stage.changes()
        numbers = number + np.arange(max(1, round(_AHEAD_S * self._rate)))
        true_times = [stage.crystal.true_time(k / self._rate) for k in numbers.tolist()]
        samples = self._signal(numbers, np.array(true_times) - stage.begin_s)
        leaves_s = 0.0
        for k, true_s, sample in zip(numbers.tolist(), true_times, samples, strict=True):
            leaves_s = max(leaves_s, true_s + stage.rng.uniform(0, stage.jitter_s))
            await asyncio.sleep(leaves_s - stage.crystal.clock())
            if stage.changes() != changes:
                return k
            self._deliver(k, true_s, sample)
        return number + len(numbers)

    def _deliver(self, number: int, true_s: float, sample: Sample) -> None:
        clients = [
            (session, client)
            for session, client in self._stage.subscribed(self._name)
            if client.is_open and self._stage.is_due(session, self._name, number)
        ]
        if not clients or not self._stage.delivers():
            return
        is_eeg = self._name == "eeg"
        lost = is_eeg and self._mishaps.loses()
        takers = [] if lost else [taker for taker in clients if taker[1].has_room]
        if not takers or self._mishaps.unannounced:
            for data_name in self._true_names:
                self._stage.truth.unsent(data_name, 1)
            for session, client in takers:
                client.send(self._write(number, sample, session.session_id, ["?"]))
            return
        if is_eeg:
            sample = self._mishaps.alter(sample)
        # Noted before it is sent: what a client has read is among the truth.
        self._note(true_s, sample)
        copies = self._mishaps.copies() if is_eeg else 1
        for session, client in takers:
            text = self._write(number, sample, session.session_id)
            for _ in range(copies):
                client.send(text)

    def _write(
        self, number: int, sample: Sample, session_id: str, further: Sequence[str] = ()
    ) -> str:
        values = [*_arranged(sample, self._columns), *further]
        time_s = round(self._stage.stamp(number / self._rate), 4)
        return json.dumps({self._name: values, "sid": session_id, "time": time_s})

    def _note(self, true_s: float, sample: Sample) -> None:
        for data_name in self._true_names:
            columns = (self._true_columns.get(label) for label in _LABELS[data_name])
            row = [nan if column is None else _number(sample[column]) for column in columns]
            self._stage.truth.sent(data_name, (true_s,), (row,))


def _declared(columns: Columns) -> dict[str, str]:
    """Columns that are sent, by their label in the declaration."""
    flat: list[str] = []
    for column in columns:
        flat += column if isinstance(column, list) else [column]
    return {_DECLARED_AS.get(column, column): column for column in flat}


def _arranged(sample: Sample, columns: Columns) -> list[Any]:
    return [
        [sample[inner] for inner in column] if isinstance(column, list) else sample[column]
        for column in columns
    ]


def _number(value: object) -> float:
    return nan if value is None else float(cast("float", value))
