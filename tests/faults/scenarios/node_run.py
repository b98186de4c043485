"""A run in which the node stands still, has a slow subscriber, and is killed and restarted.

An LSL program receives the same streams beside the node; what it got, and when, is what
each subscriber is compared with.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from biosensor_gateway.devices.registry import declaration
from tests.faults.scenarios.one_computer import PLACES, OneComputer, ThisMachine, resident_mb
from tests.rigs.hosts import completeness
from tests.rigs.hosts.completeness import MARGIN_S, Recording, Span
from tests.rigs.hosts.pair import Observation, Pair
from tests.rigs.hosts.programs import Program, SteeredProgram

SENSORS = ("zephyr", "empatica_e4")
ECG, ECG_SOURCE = "/biosensors/zephyr/ecg", "zephyr-virtual-ecg"
FAULT_S = 5.0
# At 250 Hz, 200 samples a second wait.
SLEEP_S = 0.02
# The first chunk holds samples of the four seconds before it.
LEAD_S = MARGIN_S + 4.0
CALM_S = 3.0
BACK_WITHIN_S = 2.0
FLOWS_WITHIN_S = 2.0
# Python, rclpy and DDS start in twice the time and more on a busy machine.
BUSY_S = 6.0
# What the old node sent has arrived by then.
PAUSE_S = 1.0
# Of the diagnostics, which come once a second, two have come.
SETTLED_S = 2.5


class Restart(NamedTuple):
    """Unix times: of the kill, of the new node's start, and when all had come that was sent.

    The agent stands still at the end, so that all who count have counted the same.
    """

    killed_s: float
    started_s: float
    end_s: float

    @property
    def before(self) -> Span:
        return Span(self.killed_s - CALM_S, self.started_s)

    @property
    def after(self) -> Span:
        return Span(self.started_s, self.end_s)


class NodeRun(NamedTuple):
    """What was observed."""

    observation: Observation
    regular: Mapping[str, str]  # Topic by source_id of every stream that has a rate.
    # By topic, what is wrong with what came before the kill; see `completeness`.
    losses: Mapping[str, str]
    # stalled, slow: Unix times of the first two faults.
    stalled: Span
    slow: Span
    restart: Restart
    slow_ecg: Recording  # What the slow subscriber got.
    # Of the node: before the faults, after the first, after both.
    memory_mb: tuple[float, float, float]


def drive(pair: Pair, folder: Path) -> NodeRun:
    """Do it all, with programs that run already; the pair's node is dead afterwards."""
    pair.await_matched()
    pid = pair.node.pid
    with _slow_subscriber(folder) as slow_subscriber:
        _await_first(slow_subscriber)
        time.sleep(LEAD_S + CALM_S)
        before_mb = resident_mb(pid)
        stalled = _stall(pid)
        time.sleep(BACK_WITHIN_S + CALM_S)
        stalled_mb = resident_mb(pid)
        slow = _slow_down(slow_subscriber)
        time.sleep(BACK_WITHIN_S + CALM_S + MARGIN_S)
        memory_mb = before_mb, stalled_mb, resident_mb(pid)
        slow_ecg = _save(slow_subscriber, folder / "slow.npz")
    assert isinstance(pair.agent, Program)
    restart = _kill_and_restart(pid, pair.agent.pid, folder)
    observation = pair.observe()
    required, calm = times(stalled, slow)
    losses = observation.faults_in_bad_weather(pair.expected, required, calm)
    regular = _regular(pair)
    return NodeRun(observation, regular, losses, stalled, slow, restart, slow_ecg, memory_mb)


def pair_on_this_machine(folder: Path) -> Pair:
    """Return the programs, which run as soon as this is entered."""
    return Pair(OneComputer(), PLACES, os.environ, folder, sensors=SENSORS)


def times(stalled: Span, slow: Span) -> tuple[Span, list[Span]]:
    """Return the time of which all must have come, and when all was calm."""
    first = Span(stalled.start - CALM_S, stalled.start)
    between = Span(slow.start - CALM_S, slow.start)
    last = Span(slow.end + BACK_WITHIN_S, slow.end + BACK_WITHIN_S + CALM_S)
    return Span(first.start, last.end), [first, between, last]


def _slow_subscriber(folder: Path) -> SteeredProgram:
    module = "tests.faults.scenarios.slow_subscriber"
    return SteeredProgram(ThisMachine(), os.environ, folder, module, ECG)


def _await_first(subscriber: SteeredProgram) -> None:
    while not subscriber.ask("state")["received"][ECG]:
        time.sleep(0.2)


def _stall(pid: int) -> Span:
    begin_s = time.time()
    os.kill(pid, signal.SIGSTOP)
    try:
        time.sleep(FAULT_S)
    finally:
        os.kill(pid, signal.SIGCONT)
    return Span(begin_s, time.time())


def _slow_down(subscriber: SteeredProgram) -> Span:
    begin_s = time.time()
    subscriber.ask("sleep", seconds=SLEEP_S)
    time.sleep(FAULT_S)
    subscriber.ask("sleep", seconds=0.0)
    return Span(begin_s, time.time())


def _save(subscriber: SteeredProgram, path: Path) -> Recording:
    subscriber.ask("save", path=str(path))
    return completeness.load(path)[ECG]


def _kill_and_restart(pid: int, agent_pid: int, folder: Path) -> Restart:
    """Kill the node; the new one has ended, too, when this returns."""
    again = folder / "again"
    again.mkdir()
    os.kill(pid, signal.SIGKILL)
    killed_s = time.time()
    time.sleep(PAUSE_S)
    started_s = time.time()
    with Program(ThisMachine(), os.environ, again, "lsl_to_ros.node"):
        time.sleep(FLOWS_WITHIN_S + BUSY_S)
        os.kill(agent_pid, signal.SIGSTOP)
        try:
            time.sleep(SETTLED_S)
            end_s = time.time()
        finally:
            os.kill(agent_pid, signal.SIGCONT)
    return Restart(killed_s, started_s, end_s)


def _regular(pair: Pair) -> dict[str, str]:
    topics = {
        f"/biosensors/{name}/{stream.data_name}"
        for name in SENSORS
        for stream in declaration(name).streams
        if stream.rate
    }
    return {s: place.topic for s, place in pair.expected.items() if place.topic in topics}
