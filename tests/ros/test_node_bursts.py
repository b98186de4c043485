"""Subscribers as every tutorial shows them get every sample of devices that send in bursts."""

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

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet
from tests.rigs import rcl_subscriber

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

pytestmark = pytest.mark.nightly

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
