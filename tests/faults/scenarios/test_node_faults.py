"""The node stands still for 5 s, has a slow subscriber for 5 s, is killed and restarted.

What the agent sends while there is no node is lost to ROS: LSL keeps nothing for a receiver
that is gone. The new node's diagnostics tell how much each stream had sent before it was
attached; a recording of the old node's topics tells how much of that had come.
"""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from biosensor_gateway.devices.registry import declaration
from tests.faults.scenarios import holes
from tests.faults.scenarios.figures import Record
from tests.faults.scenarios.one_computer import PLACES, OneComputer, ThisMachine, resident_mb
from tests.rigs.hosts import completeness
from tests.rigs.hosts.completeness import MARGIN_S, Recording, Span, delays, fault
from tests.rigs.hosts.pair import Observation, Pair
from tests.rigs.hosts.programs import Program, ProgramError, SteeredProgram

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


pytestmark = [pytest.mark.alone, pytest.mark.timeout(240)]

STALL, SLOW = "node's process stalled for 5 s", "slow subscriber for 5 s"
KILL = "node killed and restarted"
WINDOW_S = 0.5
# A delay is as before if it is by no more longer.
NEAR_S = 0.02
# A busy machine has to catch up with its other work, too.
BUSY_BACK_S = BACK_WITHIN_S + CALM_S - WINDOW_S
# What waits in LSL and DDS during 5 s is less than 1 MB.
MEMORY_MB = 10.0


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> NodeRun:
    folder = tmp_path_factory.mktemp("node")
    found: list[NodeRun] = []
    # The only program that does not end well is the one that was killed.
    with (
        pytest.raises(ProgramError, match=r"lsl_to_ros\.node .* exit code -9"),
        pair_on_this_machine(folder) as pair,
    ):
        found.append(drive(pair, folder))
    return found[0]


def delay_s(run: NodeRun, observed: Recording, span: Span) -> float:
    """Return the median of how much later samples came than to the LSL program."""
    came = observed.between(*span)
    if not len(came.rows):
        return np.inf
    return float(np.median(delays(run.observation.streams[ECG_SOURCE], came)))


def calm_s(run: NodeRun) -> float:
    """Return that delay before all faults."""
    begin_s = run.stalled.start
    return delay_s(run, run.observation.topics[ECG], Span(begin_s - CALM_S, begin_s))


def back_after_s(run: NodeRun, observed: Recording, end_s: float) -> float:
    """Seconds from the end of a fault until samples are no later than before all faults."""
    limit_s = calm_s(run) + NEAR_S
    starts = np.arange(end_s, end_s + BUSY_BACK_S, WINDOW_S / 5)
    windows = (Span(float(each), float(each) + WINDOW_S) for each in starts)
    back = (each for each in windows if delay_s(run, observed, each) <= limit_s)
    return next((window.start - end_s for window in back), np.inf)


def sent_until_the_kill(run: NodeRun, source: str) -> int:
    """How many samples an outlet had pushed, up to the last that came before the kill."""
    before, after = run.restart.before, run.restart.after
    stream, came = run.observation.streams[source], run.observation.topics[run.regular[source]]
    last = holes.place(stream, came, before) + len(came.between(*before).rows)
    reports = run.observation.counters.between(*after).rows
    counters = json.loads(str(reports[-1, 0]))[source]
    received = int((stream.stamps <= counters["last_stamp"]).sum())
    # The LSL program may have come when some had been pushed.
    return last + int(counters["pushed"]) - received


def test_nothing_is_lost_to_a_reliable_subscriber(run: NodeRun, figures: Record) -> None:
    for name in (STALL, SLOW):
        figures(name, "topics with a lost sample", "0", str(len(run.losses)))
    assert not run.losses


def test_nothing_is_lost_to_the_slow_subscriber(run: NodeRun, figures: Record) -> None:
    required, calm = times(run.stalled, run.slow)
    what = fault(run.observation.streams[ECG_SOURCE], run.slow_ecg, required, calm)
    figures(SLOW, "samples lost to it", "0", what or "0")
    assert not what


def test_after_a_stall_the_latency_is_soon_as_before(run: NodeRun, figures: Record) -> None:
    back_s = back_after_s(run, run.observation.topics[ECG], run.stalled.end)
    figures(STALL, "latency as before after", "≤ 2 s", f"{back_s:.1f} s")
    assert back_s <= BUSY_BACK_S


def test_a_slow_subscriber_is_soon_up_to_date(run: NodeRun, figures: Record) -> None:
    assert delay_s(run, run.slow_ecg, Span(run.slow.end - 1.0, run.slow.end)) > 1.0
    back_s = back_after_s(run, run.slow_ecg, run.slow.end)
    figures(SLOW, "latency as before after", "≤ 2 s", f"{back_s:.1f} s")
    assert back_s <= BUSY_BACK_S


def test_the_others_do_not_wait_for_a_slow_subscriber(run: NodeRun, figures: Record) -> None:
    meanwhile_s = delay_s(run, run.observation.topics[ECG], run.slow)
    text = f"{1000 * (meanwhile_s - calm_s(run)):+.1f} ms"
    figures(SLOW, "latency of another subscriber meanwhile", "as before", text)
    assert meanwhile_s <= calm_s(run) + NEAR_S


def test_the_node_s_memory_is_bounded(run: NodeRun, figures: Record) -> None:
    before, stalled, after = run.memory_mb
    figures(STALL, "node's memory before and after", "+10 MB", f"{before:.1f}, {stalled:.1f} MB")
    figures(SLOW, "node's memory before and after", "+10 MB", f"{stalled:.1f}, {after:.1f} MB")
    assert max(stalled, after) <= before + MEMORY_MB


def test_the_topics_flow_soon_after_a_restart(run: NodeRun, figures: Record) -> None:
    after = run.restart.after
    topics = [run.observation.topics[topic] for topic in run.regular.values()]
    flows_s = max(float(each.between(*after).arrivals[0]) for each in topics) - after.start
    figures(KILL, "all topics flow after the start", "≤ 2 s", f"{flows_s:.1f} s")
    assert flows_s <= FLOWS_WITHIN_S + BUSY_S


def test_what_is_lost_from_kill_to_restart_is_counted_and_announced(
    run: NodeRun, figures: Record
) -> None:
    """A subscriber may find the new node late; that it got less than the node is told apart."""
    streams, topics = run.observation.streams, run.observation.topics
    before, after = run.restart.before, run.restart.after
    facts = [facts for came_s, facts in run.observation.diagnostics if came_s < after.end][-1]
    lost, counted, late = dict[str, int](), dict[str, int](), dict[str, int]()
    for source, topic in run.regular.items():
        missing = holes.missing(streams[source], topics[topic], before, after)
        assert missing
        lost[source] = missing
        counted[source] = int(facts[topic]["sent_before"]) - sent_until_the_kill(run, source)
        late[source] = int(facts[topic]["received"]) - len(topics[topic].between(*after).rows)
        assert facts[topic]["lost"] == "0"
    text = f"{sum(counted.values())} of {sum(lost.values()) - sum(late.values())}"
    figures(KILL, "samples lost from kill to re-attachment, counted", "all", text)
    figures(KILL, "samples before the subscriber found it", "reported", str(sum(late.values())))
    assert {source: counted[source] + late[source] for source in lost} == lost
