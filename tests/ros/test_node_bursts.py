"""Bursts and overload: subscribers get every sample, or the node says what is too much."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pylsl
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float32MultiArray

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet
from tests.rigs import rcl_subscriber

if TYPE_CHECKING:
    from tests.ros.conftest import Flow, Ros, RunningNode

pytestmark = pytest.mark.nightly

# Subscribers as every tutorial shows them get every sample of devices that send in bursts.

# Sensor, data name, samples that come at once: a Polar H10's packet, and a BioHarness's.
DEVICES = (("polar_h10", "ecg", 73), ("zephyr", "ecg", 63))
QUEUES = ((5, "reliable"), (10, "reliable"), (5, "best_effort"), (10, "best_effort"))
# Of a round's samples. Even with pacing a computer whose tests wait for each other may lose
# some, so the best of several rounds counts; make bench counts all. Without it, the shortest
# queues get 0.1 to 0.75: how much a subscriber takes of a burst meanwhile is its speed.
PACED, AT_ONCE = 0.9, 0.85
ROUND_S, SETTLE_S, DEADLINE_S = 3.0, 0.5, 90.0


class Bursts:
    """A device that sends numbered samples, many at once, at its own rate."""

    def __init__(self, name: str, data: str, size: int) -> None:
        stream = declaration(name).stream(data)
        self.topic = f"/biosensors/{name}/{data}"
        self.size = size
        self.pushed = 0
        self._outlet = Outlet(stream, DeviceIdentity(name, "U1"), DeviceInfo())
        self._period_s = size / float(str(stream.rate))
        self._due_s = pylsl.local_clock()

    def step(self) -> None:
        """Send what is due."""
        now_s = pylsl.local_clock()
        if now_s < self._due_s:
            return
        numbers = np.arange(self.size, dtype=float)
        stamps = self._due_s - self._period_s * (1.0 - numbers / self.size)
        assert self._outlet.push((self.pushed + numbers).tolist(), stamps.tolist()) is None
        self.pushed += self.size
        # No two bursts come closer than a device's, however late this one was.
        self._due_s = now_s + self._period_s


class Subscriber:
    """The process of one."""

    def __init__(
        self, program: Sequence[str], depth: int, reliability: str, topics: list[str]
    ) -> None:
        self.name = f"depth {depth}, {reliability}"
        options = [word for topic in topics for word in (topic, "std_msgs/msg/Float32")]
        command = [sys.executable, "-m", *program, str(depth), reliability, *options]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def heard(self) -> dict[str, list[float]]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def stop(self) -> None:
        self._process.communicate(timeout=30.0)


@pytest.fixture
def devices() -> list[Bursts]:
    return [Bursts(*device) for device in DEVICES]


@pytest.fixture(params=["rclpy", pytest.param("rcl", marks=pytest.mark.system)])
def program(request: pytest.FixtureRequest, tmp_path: Path) -> list[str]:
    """What subscribes: the whole of rclpy, or in C the layer that rclcpp stands on, too."""
    if request.param == "rcl":
        return ["tests.rigs.rcl_subscriber", str(rcl_subscriber.build(tmp_path))]
    return ["tests.rigs.tutorial_subscriber"]


@pytest.fixture
def subscribers(program: list[str], devices: list[Bursts]) -> Iterator[list[Subscriber]]:
    topics = [device.topic for device in devices]
    running = [Subscriber(program, *queue, topics) for queue in QUEUES]
    yield running
    for each in running:
        each.stop()


def play(devices: list[Bursts], seconds: float) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        for device in devices:
            device.step()
        time.sleep(0.005)


def play_round(devices: list[Bursts], subscribers: list[Subscriber]) -> dict[str, float]:
    """Let the devices send for a while; return the share that each got of the worst topic."""
    first = {device.topic: device.pushed for device in devices}
    play(devices, ROUND_S)
    end = {device.topic: device.pushed for device in devices}
    time.sleep(SETTLE_S)
    shares: dict[str, float] = {}
    for each in subscribers:
        heard = {
            topic: [number for number in numbers if number >= first[topic]]
            for topic, numbers in each.heard().items()
        }
        assert all(numbers == sorted(set(numbers)) for numbers in heard.values()), each.name
        shares[each.name] = min(len(heard[topic]) / (end[topic] - first[topic]) for topic in end)
    return shares


def test_bursts_reach_subscribers_with_short_queues(
    ros: Ros,
    start_node: Callable[..., RunningNode],
    devices: list[Bursts],
    subscribers: list[Subscriber],
    record_property: Callable[[str, object], None],
) -> None:
    start_node()
    ros.attached(*(device.topic for device in devices), readers=len(subscribers))
    incomplete, deadline_s = {each.name for each in subscribers}, time.monotonic() + DEADLINE_S
    rounds: list[dict[str, float]] = []
    while incomplete:
        assert time.monotonic() < deadline_s, rounds
        rounds.append(play_round(devices, subscribers))
        incomplete -= {name for name, share in rounds[-1].items() if share >= PACED}
    assert ros.set("burst_pacing", 0.0) == ""
    at_once = play_round(devices, subscribers)
    record_property("paced", rounds)
    record_property("at once", at_once)
    assert min(at_once.values()) < AT_ONCE, at_once


# The running node says what is too much, for itself and for who reads its topics.
# A busy computer need publish only half of it.
RATE_HZ, QUEUED = 8000.0, 30


def outlet(name: str, rate: float) -> pylsl.StreamOutlet:
    return pylsl.StreamOutlet(pylsl.StreamInfo(name, "EEG", 1, rate, "float32", f"id of {name}"))


def says(ros: Ros, topic: str, *parts: str) -> bool:
    status = ros.status(topic)
    return (
        status is not None
        and status.level == DiagnosticStatus.WARN
        and all(part in status.message for part in parts)
    )


@pytest.fixture
def plotter(ros: Ros) -> Iterator[Node]:
    """A node that takes no message, as one that is too slow; its queue throws them away."""
    del ros
    node = rclpy.create_node("plotter")
    yield node
    node.destroy_node()


@pytest.mark.usefixtures("node")
def test_a_topic_that_nobody_can_follow_is_told_with_who_reads_it(
    ros: Ros, flow: Callable[..., Flow], plotter: Node
) -> None:
    topic = "/biosensors/sound/EEG"
    sound = outlet("sound", RATE_HZ)
    qos = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    plotter.create_subscription(Float32MultiArray, topic, lambda _: None, qos)
    assert ros.set("burst_pacing", 0.0) == ""
    ros.attached(topic, readers=1)
    flowing = flow(sound, RATE_HZ)
    expected = ("messages per second", f"read {topic}_chunk instead", "plotter: best effort")
    ros.until(lambda: says(ros, topic, *expected), "the topic is too fast")
    pushed = flowing.stop()

    def is_told() -> bool:
        status = ros.status(topic)
        return status is not None and status["published"] == status["received"] == str(pushed)

    ros.until(is_told, "what was published is counted")
    ros.until(lambda: not says(ros, topic, "messages per second"), "it is over")
    load = ros.status("node")
    assert load is not None
    assert float(load["cpu_percent"]) > 0.0
    assert ros.set("burst_pacing", 0.5) == ""


@pytest.mark.usefixtures("node")
def test_data_that_wait_in_the_node_are_told_until_they_have_gone(
    ros: Ros, node: RunningNode
) -> None:
    topic = "/biosensors/held/EEG"
    held = outlet("held", 0.0)
    heard = ros.listen(Float32MultiArray, topic)
    assert ros.set("burst_pacing", 0.001) == ""
    ros.attached(topic, readers=1)
    held.push_chunk([[float(number)] for number in range(QUEUED)])

    def are_told() -> bool:
        shown = [ros.status(name) for name in (topic, "node")]
        have_waited = all(each is not None and float(each["queue_age_s"]) >= 1.0 for each in shown)
        return have_waited and says(ros, "node", "data has waited", "Sensor_Enable")

    ros.until(are_told, "data wait")
    ros.until(lambda: node.count("data has waited") >= 1, "the log says it, too")
    assert ros.set("burst_pacing", 0.0) == ""
    ros.until(lambda: len(heard) == QUEUED, "all samples")
    ros.until(lambda: not says(ros, "node", "data has waited"), "nothing waits any more")
    assert ros.set("burst_pacing", 0.5) == ""
