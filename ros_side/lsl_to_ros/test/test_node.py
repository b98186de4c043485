"""The node as it is installed: a stream in, topics out, a clean end; run by ``colcon test``."""

# ruff: noqa: E402 - ROS and LSL may not be there

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

# rosdep has no key for it, so it may not be on a build farm.
pylsl = pytest.importorskip("pylsl")

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from std_msgs.msg import Float32MultiArray

DEADLINE_S = 60.0
OUTLET = """
import itertools, time, pylsl
outlet = pylsl.StreamOutlet(pylsl.StreamInfo("bench", "EEG", 2, 100.0, "float32", "bench-1"))
for n in itertools.count():
    outlet.push_sample([n, n + 0.5])
    time.sleep(0.01)
"""


@pytest.fixture(autouse=True)
def _alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let LSL and ROS see this test only."""
    settings = tmp_path / "lsl_api.cfg"
    settings.write_text(
        f"[lab]\nSessionID = test-{uuid.uuid4().hex}\nKnownPeers = {{127.0.0.1}}\n"
        "[multicast]\nResolveScope = machine\n[log]\nlevel = -2\n"
    )
    monkeypatch.setenv("LSLAPICFG", str(settings))
    monkeypatch.setenv("ROS_DOMAIN_ID", str(random.randrange(1, 102)))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))


@pytest.fixture
def programs(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """Start a sender of LSL, and the node; give the node and what it says."""
    said = tmp_path / "node.txt"
    with (
        said.open("wb") as output,
        subprocess.Popen([sys.executable, "-c", OUTLET]) as outlet,
        subprocess.Popen(
            [sys.executable, "-m", "lsl_to_ros.node"], stdout=output, stderr=output
        ) as node,
    ):
        yield node, said
        for program in (node, outlet):
            program.kill()


def _received(topic: str, count: int) -> list[list[float]]:
    """Return the values of the messages that came until there were enough, or for the deadline."""
    rclpy.init(args=[])
    node = rclpy.create_node("listener")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    values: list[list[float]] = []
    node.create_subscription(
        Float32MultiArray, topic, lambda m: values.append(list(m.data)), QoSProfile(depth=1000)
    )
    end = time.monotonic() + DEADLINE_S
    while len(values) < count and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()
    return values


def test_a_stream_comes_out_as_a_topic_and_the_node_ends_cleanly(
    programs: tuple[subprocess.Popen[bytes], Path],
) -> None:
    node, said = programs
    values = _received("/biosensors/bench/EEG", 20)
    assert len(values) >= 20, said.read_text()
    first = values[0][0]
    assert values == [[first + n, first + n + 0.5] for n in range(len(values))]
    os.kill(node.pid, signal.SIGINT)
    assert node.wait(DEADLINE_S) == 0, said.read_text()
    text = said.read_text()
    assert "Traceback" not in text
    # A file of settings that Fast DDS does not take is known by such lines alone.
    assert "XMLPARSER" not in text
