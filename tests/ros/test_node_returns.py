"""Streams vanish and return, also when the program that sends them is killed."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from statistics import median
from typing import TYPE_CHECKING, Any

import pylsl
import pytest
from std_msgs.msg import Float32, Float32MultiArray

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet
from tests.rigs.polling import wait_until
from tests.rigs.processes import stands_still, waiting_bytes
from tests.rigs.stopwatch import Stopwatch

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("node")]

# The requirement: a stream flows again so soon after its outlet is there.
RETURN_S = 2.0

# Obeys its input line by line; each answer is the LSL time at which it was done.
PROGRAM = """
import json, sys, time
import pylsl

for line in sys.stdin:
    order, argument = json.loads(line)
    if order == "open":
        outlets = [
            pylsl.StreamOutlet(pylsl.StreamInfo(name, "EEG", 1, rate, "float32", source_id))
            for name, rate, source_id in argument
        ]
        begun, pushed = pylsl.local_clock(), 0
    if order == "push":
        # The stamps have no gap, however long the push before it is ago.
        stamps = [begun + (pushed + number) / 100 for number in range(argument)]
        pushed += argument
        for outlet in outlets:
            outlet.push_chunk([[1.0]] * argument, stamps)
    print(pylsl.local_clock(), flush=True)
    while order == "flow":
        for outlet in outlets:
            outlet.push_sample([argument])
        time.sleep(0.01)
"""


class Program:
    """Another program with outlets of its own."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def do(self, order: str, argument: Any) -> float:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([order, argument]) + "\n")
        self._process.stdin.flush()
        return float(self._process.stdout.readline())

    def kill(self) -> None:
        """End it without any chance to say goodbye."""
        self._process.kill()
        self._process.communicate()


@pytest.fixture
def start_program() -> Iterator[Callable[[], Program]]:
    started: list[Program] = []

    def start() -> Program:
        started.append(Program())
        return started[-1]

    yield start
    for program in started:
        program.kill()


def declared(sensor_name: str, data: str, unit: str, who: str) -> Outlet:
    identity = DeviceIdentity(sensor_name, unit, participant=who)
    return Outlet(declaration(sensor_name).stream(data), identity, DeviceInfo())


def foreign(name: str, source_id: str) -> pylsl.StreamOutlet:
    return pylsl.StreamOutlet(pylsl.StreamInfo(name, "EEG", 1, 0.0, "float32", source_id))


@pytest.mark.seam
def test_an_outlet_that_returns_is_attached_again(ros: Ros) -> None:
    topic = "/back/biosensors/polar_h10/ecg"
    assert ros.set("back.polar_h10.Chunk_Length", 4) == ""
    outlet = declared("polar_h10", "ecg", "U1", who="back")
    raw = ros.listen(Float32, topic)
    chunks = ros.listen(Float32MultiArray, f"{topic}_chunk")
    ros.attached(topic, readers=2)
    now = pylsl.local_clock()
    assert outlet.push(range(6), [now + number / 130 for number in range(6)]) is None
    ros.until(lambda: len(raw) == 6 and len(chunks) == 1, "six samples and a chunk")
    del outlet
    ros.until(lambda: topic not in ros.present(), "its end")
    outlet = declared("polar_h10", "ecg", "U1", who="back")
    ros.attached(topic, readers=2)
    now = pylsl.local_clock()
    assert outlet.push(range(10, 14), [now + number / 130 for number in range(4)]) is None
    ros.until(lambda: len(raw) >= 10 and len(chunks) >= 2, "four more samples and a chunk")
    assert [message.data for message in raw] == [0, 1, 2, 3, 4, 5, 10, 11, 12, 13]
    assert [list(chunk.data) for chunk in chunks] == [[0, 1, 2, 3], [10, 11, 12, 13]]
    ros.report()
    status = ros.status(topic)
    assert status is not None
    assert (status["received"], status["chunk_discarded"]) == ("10", "2")


def test_a_program_that_starts_with_a_new_source_id_keeps_its_topic(ros: Ros) -> None:
    topic = "/biosensors/restarted/EEG"
    heard = ros.listen(Float32MultiArray, topic)
    for source_id in ("run 1", "run 2", ""):
        outlet = foreign("restarted", source_id)
        ros.attached(topic, readers=1)
        outlet.push_sample([1.0], pylsl.local_clock())
        heard.clear()
        ros.until(lambda: bool(heard), f"a sample under the id {source_id!r}")
        del outlet
        ros.until(lambda: topic not in ros.present(), "its end")


@pytest.mark.alone
def test_what_a_killed_program_sent_flows_again_two_seconds_after_it_is_back(
    ros: Ros, node: RunningNode, start_program: Callable[[], Program]
) -> None:
    names = ("same_id", "empty_id", "new_id", "new_rate")

    def streams(number: int) -> list[tuple[str, float, str]]:
        return [
            ("same_id", 100.0, "same id"),
            ("empty_id", 100.0, ""),
            ("new_id", 100.0, f"id of run {number}"),
            ("new_rate", 100.0 + number, "an id"),
        ]

    heard = {name: ros.listen(Float32MultiArray, f"/biosensors/{name}/EEG") for name in names}
    delays: dict[str, list[float]] = {name: [] for name in names}
    program = start_program()
    for number in range(4):
        following = start_program()
        following.do("wait", 0)
        watch = Stopwatch()
        up = program.do("open", streams(number))
        program.do("flow", float(number))
        missing: set[str] = {*names}

        def all_flow(
            number: int = number,
            missing: set[str] = missing,
            up: float = up,
            watch: Stopwatch = watch,
        ) -> bool:
            for name in list(missing):
                if heard[name] and heard[name][-1].data[0] == number:
                    missing.remove(name)
                    delays[name].append(pylsl.local_clock() - up - watch.stalled_s())
            return not missing

        ros.until(all_flow, f"samples of run {number} on each topic")
        program.kill()
        program = following
    for name, (_, *returns) in delays.items():
        print(f"{name}: {', '.join(f'{delay:.2f}' for delay in returns)} s")
        assert median(returns) <= RETURN_S, name
        runs = [message.data[0] for message in heard[name]]
        assert runs == sorted(runs)
        changes = len(returns) if name == "new_rate" else 0
        assert node.count("[WARN]", f"{name}/EEG: the stream was restarted as") == changes


def test_what_lsl_drops_when_a_program_is_killed_is_counted(
    ros: Ros, node: RunningNode, start_program: Callable[[], Program]
) -> None:
    streams = [(f"dropped{place}", 100.0, f"id of dropped{place}") for place in (1, 2, 3)]
    topics = [f"/biosensors/{name}/EEG" for name, _, _ in streams]
    program, following = start_program(), start_program()
    program.do("open", streams)
    ros.attached(*topics)
    program.do("push", 50)

    def received(count: int) -> bool:
        found = [ros.status(topic) for topic in topics]
        return all(status is not None and status["received"] == str(count) for status in found)

    ros.until(lambda: received(50), "fifty samples of each at the node")
    # While the node stands still, its sockets take in samples; then it sees the end at once.
    node.send(signal.SIGSTOP)
    try:
        wait_until(lambda: stands_still(node.pid), "that the node stands still")
        program.do("push", 500)
        # A sample has a byte for its stamp's kind, eight for the stamp and four for the value.
        wait_until(
            lambda: sum(waiting >= 500 * 13 for waiting in waiting_bytes(node.pid)) == len(streams),
            "all samples in the node's sockets",
        )
        program.kill()
    finally:
        node.send(signal.SIGCONT)
    ros.until(lambda: not set(topics) & ros.present(), "the end of the streams")
    following.do("open", streams)
    ros.attached(*topics)
    for topic, (name, _, _) in zip(topics, streams, strict=True):
        status = ros.status(topic)
        assert status is not None
        assert status["lost"].startswith("about ")
        lost = int(status["lost"].removeprefix("about "))
        print(f"{topic}: {status['received']} received, {lost} lost")
        assert int(status["received"]) + lost == 550
        assert node.count("[WARN]", name, f"{lost} samples were lost") == (1 if lost else 0)
