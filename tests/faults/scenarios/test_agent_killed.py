"""An agent that is kept alive is killed while LabRecorder and the node receive its streams."""

from __future__ import annotations

import os
import signal
import sys
import time
import uuid
from collections.abc import Generator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pylsl
import pytest

from biosensor_common.naming import source_id
from biosensor_common.spec import DeviceIdentity
from tests.faults.agent import AgentProcess
from tests.faults.expectations import regular_streams, unit_of
from tests.faults.matching import match, missing
from tests.faults.recorder import Floats, Recorded
from tests.faults.scenarios.figures import Record
from tests.faults.scenarios.stage import is_streaming, lab_of, wait_until, write_settings
from tests.faults.scenarios.xdf import load
from tests.rigs.lab_client import LabProcess, Samples
from tests.system.lab_recorder import recording
from tests.system.programs import Program

FAULT = "agent killed in mid-recording, with --keep-alive"
KILLED = ("zephyr", "empatica_e4", "shimmer3_gsr")
OTHER = ("emotiv_insight", "vernier_respiration_belt")
# What an agent has to start with is Python and its libraries, on a computer that is busy.
BUSY = 3
LOST_LIMIT_S, FLOWS_LIMIT_S = 2.0, 2.0
BEFORE_S, AFTER_S = 3.0, 4.0
# Like no other in the network: liblsl recovers a stream by its source_id, in any session.
PARTICIPANT = f"p{uuid.uuid4().hex[:8]}"


def source(name: str, data_name: str) -> str:
    return source_id(DeviceIdentity(name, unit_of(name), PARTICIPANT), data_name)


# Those that come often, one per sensor.
TOPICS = {
    f"/{PARTICIPANT}/biosensors/{name}/acc": source(name, "acc")
    for name in ("zephyr", "empatica_e4")
}

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(240)]


class Aftermath(NamedTuple):
    """What was recorded, what was measured, and when what came back (LSL clock)."""

    recorded: Mapping[str, Recorded]
    truth: Mapping[str, Samples]
    killed_s: float
    up_s: Mapping[str, float]
    flows_s: Mapping[str, float]

    def back_s(self, source_id: str) -> float:
        """When the first sample that was recorded after the kill was measured."""
        times = self._measured_s(source_id)
        return float(times[times > self.killed_s][0])

    def lost_s(self, source_id: str) -> float:
        """The longest time between two samples, less that between any two."""
        period_s = float(np.median(np.diff(self.truth[source_id].times)))
        return float(np.diff(self._measured_s(source_id)).max()) - period_s

    def _measured_s(self, source_id: str) -> Floats:
        truth = self.truth[source_id]
        return truth.times[match(self.recorded[source_id], truth)]


class Listener:
    """A subscriber in a process of its own."""

    def __init__(self, program: Program) -> None:
        self._program = program

    def counts(self) -> dict[str, int]:
        """How many messages came so far, by topic."""
        heard = [record["topic"] for record in self._program.records]
        return {topic: heard.count(topic) for topic in TOPICS}


@contextmanager
def listening(folder: Path) -> Generator[Listener]:
    """The node, and somebody who has heard from each topic."""
    kinds = [word for topic in TOPICS for word in ("std_msgs/msg/Float32MultiArray", topic)]
    node = Program([sys.executable, "-m", "lsl_to_ros.node"], folder / "node.txt")
    command = [sys.executable, "-m", "tests.system.listener", *kinds]
    program = Program(command, folder / "listener.txt")
    try:
        listener = Listener(program)
        wait_until(lambda: all(listener.counts().values()), "messages on every topic")
        yield listener
    finally:
        program.end()
        node.end()


def sources(names: tuple[str, ...]) -> list[str]:
    return [source(name, data_name) for name in names for data_name in regular_streams(name)]


def wait_for_outlets(resolver: pylsl.ContinuousResolver, since_s: float) -> dict[str, float]:
    """When each outlet of the killed agent was made again, by source_id."""
    awaited, made = set(sources(KILLED)), dict[str, float]()

    def all_are_there() -> bool:
        # The types of pylsl do not know this method.
        infos: list[Any] = list(resolver.results())
        times = {info.source_id(): float(info.created_at()) for info in infos}
        made.update({each: time_s for each, time_s in times.items() if time_s > since_s})
        return awaited <= made.keys()

    wait_until(all_are_there, "the outlets of the new agent")
    return made


def wait_for_messages(listener: Listener, before: Mapping[str, int]) -> dict[str, float]:
    """When each topic had a message more."""
    came: dict[str, float] = {}

    def all_came() -> bool:
        for topic, count in listener.counts().items():
            if count > before[topic]:
                came.setdefault(topic, pylsl.local_clock())
        return came.keys() == TOPICS.keys()

    wait_until(all_came, "messages on every topic")
    return came


def truth_of(lab: LabProcess) -> dict[str, Samples]:
    truths = {name: lab.truth(name) for name in KILLED + OTHER}
    return {
        source(name, data_name): samples
        for name, truth in truths.items()
        for data_name, samples in truth.items()
    }


@pytest.fixture(scope="module")
def aftermath(tmp_path_factory: pytest.TempPathFactory) -> Aftermath:
    folder = tmp_path_factory.mktemp("killed")
    first, other = folder / "first", folder / "other"
    first.mkdir()
    other.mkdir()
    with lab_of(KILLED + OTHER, folder) as lab, ExitStack() as stack:
        settings = write_settings(first, lab, {name: name for name in KILLED}, PARTICIPANT)
        others = write_settings(other, lab, {name: name for name in OTHER}, PARTICIPANT)
        untouched = AgentProcess(other, *others, environment=lab.environment)
        stack.enter_context(untouched)
        agent = AgentProcess(first, "--keep-alive", *settings, environment=lab.environment)
        stack.enter_context(agent)
        wait_until(lambda: is_streaming(agent) and is_streaming(untouched), "streaming devices")
        wait_until(lambda: agent.standby, "a standby")
        listener = stack.enter_context(listening(folder))
        resolver = pylsl.ContinuousResolver()
        with recording(folder / "killed.xdf", sources(KILLED + OTHER)):
            time.sleep(BEFORE_S)
            standby = agent.standby
            killed_s = pylsl.local_clock()
            os.kill(agent.serving, signal.SIGKILL)
            before = listener.counts()
            flows_s = wait_for_messages(listener, before)
            up_s = wait_for_outlets(resolver, killed_s)
            time.sleep(AFTER_S)
        truth = truth_of(lab)
        assert agent.serving == standby
    return Aftermath(load(folder / "killed.xdf"), truth, killed_s, up_s, flows_s)


def test_the_streams_of_the_file_go_on(aftermath: Aftermath, figures: Record) -> None:
    up_s = aftermath.up_s
    lost_s = {each: aftermath.lost_s(each) for each in sources(KILLED)}
    worst = max(lost_s, key=lambda each: lost_s[each])
    down_s = up_s[worst] - aftermath.killed_s
    figures(FAULT, "lost of a stream", f"<= {LOST_LIMIT_S:g} s",
            f"{lost_s[worst]:.1f} s, of which the agent was down for {down_s:.1f} s")  # fmt: skip
    found_s = {each: aftermath.back_s(each) - up_s[each] for each in lost_s}
    figures(FAULT, "recorded again after the outlets are up", f"<= {LOST_LIMIT_S:g} s",
            f"{max(found_s.values()):.1f} s")  # fmt: skip
    assert max(found_s.values()) <= BUSY * LOST_LIMIT_S


def test_those_of_another_agent_lose_nothing(aftermath: Aftermath, figures: Record) -> None:
    lost = 0
    for each in sources(OTHER):
        recorded, truth = aftermath.recorded[each], aftermath.truth[each]
        lost += missing(match(recorded, truth), truth)
    figures(FAULT, "lost of another agent's streams", "0", str(lost))
    assert lost == 0


def test_topics_flow_again(aftermath: Aftermath, figures: Record) -> None:
    after_s = [aftermath.flows_s[topic] - aftermath.up_s[each] for topic, each in TOPICS.items()]
    figures(FAULT, "topics flow after the outlets are up", "<= 2 s", f"{max(after_s):.2f} s")
    assert max(after_s) <= BUSY * FLOWS_LIMIT_S
