"""All devices for a long time without any fault: nothing is lost, nothing grows.

Half a minute in the quick part, half an hour by ``make faults``, and as long as the
variable below says: twelve hours by ``make faults LONG=1``.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pylsl
import pytest

from benchmarks.processes import Process
from benchmarks.slope import fit
from tests.faults.agent import fresh_status
from tests.faults.expectations import SENSORS, is_by_agent, numeric_streams, source, steady_streams
from tests.faults.scenarios.figures import Record, is_long
from tests.faults.scenarios.ledger import CounterLedger, DrainedRecorder, TruthLedger
from tests.faults.scenarios.stage import channels_of, lab_of, wait_until, write_settings
from tests.rigs.lab_client import LabProcess, Samples
from tests.rigs.turns import turns

SECONDS = float(os.environ.get("BIOSENSOR_GATEWAY_STEADY_S") or (1800 if is_long() else 30))
# More devices than these are more than two processors carry beside other tests; alone, all of them.
TURNS = (SENSORS,) if is_long() else turns(SENSORS)
# So long the memory of both programs grows fast, and slower all the time.
FULL_WARM_UP_S = 300.0
WARM_UP_S = min(FULL_WARM_UP_S, SECONDS / 5)
ROUND_S = min(60.0, SECONDS / 2)
# Of each stream, so much that nothing is forgotten between two rounds.
KEPT = int(250 * (ROUND_S + 120))
# The slowest sample comes six seconds after it was measured, and a busy machine adds to it.
IN_FLIGHT_S = 4.0
# What has not come so long after the end is lost.
LATEST_S = 30.0
SAMPLE_S = 1.0
# A pool of threads starts them one by one, as work comes.
POOL = 4

Truths = Mapping[str, Mapping[str, Samples]]

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.timeout(SECONDS * 1.5 + 300),
    pytest.mark.skipif(sys.platform != "linux", reason="reads /proc"),
]


@dataclass
class Footprint:
    """What a process takes, once a second."""

    times: list[float] = field(default_factory=list[float])
    memory_mb: list[float] = field(default_factory=list[float])
    threads: list[int] = field(default_factory=list[int])
    descriptors: list[int] = field(default_factory=list[int])

    def look(self, process: Process) -> None:
        self.times.append(time.monotonic())
        self.memory_mb.append(process.memory_mb)
        self.threads.append(process.threads)
        self.descriptors.append(process.descriptors)


def growth(counts: list[int]) -> int:
    """By how much the last third is usually above the most of the first one."""
    third = len(counts) // 3
    return int(np.median(counts[-third:])) - max(counts[:third])


@dataclass
class SteadyRun:
    """The books of all streams at the end, by sensor and data name, and what it took."""

    sensors: tuple[str, ...]
    sent: dict[tuple[str, str], TruthLedger]
    pushed: dict[tuple[str, str], CounterLedger]
    overdue: dict[tuple[str, str], int]
    counters: Mapping[str, Mapping[str, Any]]
    footprints: Mapping[str, Footprint]

    @property
    def fault(self) -> str:
        """What the figures call it."""
        which = "all" if len(self.sensors) == len(SENSORS) else "+".join(self.sensors)
        return f"steady, {which} {len(self.sensors)} devices, {SECONDS / 60:g} min"


class Books:
    """Settles all streams from time to time."""

    def __init__(self, lab: LabProcess, recorder: DrainedRecorder, state: Path) -> None:
        self._lab, self._recorder, self._state = lab, recorder, state
        self.sensors = tuple(lab.settings)
        self._streams = [(name, each) for name in self.sensors for each in numeric_streams(name)]
        self._begin_s = pylsl.local_clock()
        counters = self.counters()
        self.sent = {each: TruthLedger() for each in self._streams if not is_by_agent(*each)}
        self.pushed: dict[tuple[str, str], CounterLedger] = {}
        for stream in self._streams:
            counter, came = counters[source(*stream)], recorder.take(source(*stream))
            ledger = CounterLedger(counter["pushed"], counter["last_stamp"], came.times)
            self.pushed[stream] = ledger

    def counters(self) -> Mapping[str, Mapping[str, Any]]:
        """What the agent says of each stream."""
        devices = fresh_status(self._state)["devices"]
        return {key: value for device in devices for key, value in device["streams"].items()}

    def truths(self) -> Truths:
        return {name: self._lab.truth(name) for name in self.sensors}

    def settle(self) -> None:
        """Account for what came since the last time."""
        counters = self.counters()
        time.sleep(IN_FLIGHT_S)
        came = {stream: self._recorder.take(source(*stream)) for stream in self._streams}
        truths = self.truths()
        for stream, recorded in came.items():
            counter = counters[source(*stream)]
            self.pushed[stream].settle(recorded, counter["pushed"], counter["last_stamp"])
            name, data_name = stream
            if stream in self.sent and data_name in truths[name]:
                self.sent[stream].settle(recorded, truths[name][data_name])

    def overdue(self, truths: Truths) -> dict[tuple[str, str], int]:
        """Samples sent before a time that have not come, by stream."""
        return {
            (name, data_name): ledger.overdue(truths[name][data_name], self._begin_s)
            for (name, data_name), ledger in self.sent.items()
            if data_name in truths[name]
        }


@pytest.fixture(scope="module", params=TURNS, ids="+".join)
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> SteadyRun:
    sensors: tuple[str, ...] = request.param
    folder = tmp_path_factory.mktemp("steady")
    with lab_of(sensors, folder, jitter_s=0.01, kept=KEPT) as lab, ExitStack() as stack:
        settings = write_settings(folder, lab, {name: name for name in sensors})
        environment = {**os.environ, **lab.environment, "BIOSENSOR_GATEWAY_STATE": str(folder)}
        command = ["biosensor_gateway.cli", "run", *settings]
        agent = stack.enter_context(Process(command, environment, folder / "agent.txt"))
        node = stack.enter_context(Process(["lsl_to_ros.node"], environment, folder / "node.txt"))
        with DrainedRecorder(channels_of(sensors)) as recorder:
            awaited = [source(name, each) for name in sensors for each in steady_streams(name)]
            wait_until(lambda: all(map(recorder.newest, awaited)), "streaming devices")
            time.sleep(WARM_UP_S)
            ended = run_for(SECONDS, Books(lab, recorder, folder), {"agent": agent, "node": node})
        node.stop()
        agent.stop()
    return ended


def run_for(seconds: float, books: Books, processes: Mapping[str, Process]) -> SteadyRun:
    """Look at the processes all the time, and settle the books now and then."""
    footprints = {program: Footprint() for program in processes}
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        round_end_s = min(end_s, time.monotonic() + ROUND_S)
        while time.monotonic() < round_end_s:
            for program, process in processes.items():
                footprints[program].look(process)
            time.sleep(SAMPLE_S)
        books.settle()
    truths = books.truths()
    end_s = time.monotonic() + LATEST_S
    books.settle()
    while any(books.overdue(truths).values()) and time.monotonic() < end_s:
        books.settle()
    return SteadyRun(
        books.sensors, books.sent, books.pushed, books.overdue(truths), books.counters(), footprints
    )


def test_what_was_sent_was_received(run: SteadyRun, figures: Record) -> None:
    received = sum(ledger.received for ledger in run.sent.values())
    lost = sum(ledger.lost for ledger in run.sent.values()) + sum(run.overdue.values())
    figures(run.fault, "lost, duplicated, reordered of the samples that devices sent", "0",
            f"{lost} of {received:,} in {len(run.sent)} streams")  # fmt: skip
    assert received
    assert {stream: ledger.lost for stream, ledger in run.sent.items() if ledger.lost} == {}
    assert {stream: count for stream, count in run.overdue.items() if count} == {}


def test_what_was_pushed_was_received(run: SteadyRun, figures: Record) -> None:
    wrong = {stream: each.difference for stream, each in run.pushed.items() if each.difference}
    figures(run.fault, "received less pushed by the agent", "0 per stream",
            f"0 in {len(run.pushed) - len(wrong)} of {len(run.pushed)} streams")  # fmt: skip
    assert wrong == {}
    for each in run.counters.values():
        assert (each["lost"], each["refused"]) == (0, 0)


@pytest.mark.parametrize("program", ["agent", "node"])
def test_nothing_grows(run: SteadyRun, figures: Record, program: str) -> None:
    footprint = run.footprints[program]
    hours = np.array(footprint.times) / 3600
    slope = fit(hours, footprint.memory_mb)
    cold = "" if WARM_UP_S == FULL_WARM_UP_S else " (still warming up)"
    figures(run.fault, f"memory slope of the {program}{cold}", "reported",
            f"{slope.value:+.1f} MB/h [{slope.low:+.1f}, {slope.high:+.1f}], "
            f"{footprint.memory_mb[-1]:.0f} MB")  # fmt: skip
    threads, descriptors = growth(footprint.threads), growth(footprint.descriptors)
    figures(run.fault, f"threads and descriptors of the {program}", "flat",
            f"{max(threads, 0):+d} and {max(descriptors, 0):+d}")  # fmt: skip
    assert threads <= POOL
    assert descriptors <= 0
