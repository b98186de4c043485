"""The node tells recorders of LSL what its computer's clock shows; once, whatever it runs as."""

from __future__ import annotations

import json
import re
import signal
import time
from collections.abc import Callable
from statistics import median
from typing import TYPE_CHECKING, Any

import pylsl
import pytest
from std_msgs.msg import Float32MultiArray

from biosensor_common.lsl_header import read_header
from biosensor_common.naming import NODE
from biosensor_common.ros_clock import NS_PER_S, measure_offset_ns, read_clock_pair
from lsl_to_ros.reports.clock_pairs import unit_of
from tests.rigs.stopwatch import Stopwatch

if TYPE_CHECKING:
    from tests.ros.conftest import Flow, Ros, RunningNode


ARGUMENTS = ("--ros-args", "-p", "use_sim_time:=true")
PATIENCE_S = 30.0
SAME_NS = 1_000_000


class _Named:
    """What is asked of a node for its name among all."""

    def __init__(self, name: str, domain: int) -> None:
        self._name, self._domain = name, domain

    @property
    def context(self) -> _Named:
        return self

    def get_fully_qualified_name(self) -> str:
        return self._name

    def get_domain_id(self) -> int:
        return self._domain


@pytest.mark.nightly
def test_there_is_one_stream_of_pairs_also_in_simulated_time_and_no_topic_of_it(
    ros: Ros, start_node: Callable[..., RunningNode]
) -> None:
    running = start_node(*ARGUMENTS)
    (found,) = _own_streams()
    inlet = pylsl.StreamInlet(found, recover=False)
    header = read_header(inlet.info(PATIENCE_S).as_xml())
    assert (header.identity.sensor, header.data_name, header.foreign) == (NODE, "events", False)
    (text,), stamp = inlet.pull_sample(PATIENCE_S)
    event: dict[str, Any] = json.loads(text)
    assert event["event"] == "heartbeat"
    assert event["use_sim_time"] is True
    assert event["node"] == "/lsl_to_ros"
    pair = read_clock_pair(event)
    assert pair is not None
    assert stamp == pytest.approx(pair.lsl_s, abs=1e-9)
    expected_ns = measure_offset_ns(time.time_ns, pylsl.local_clock)
    assert pair.unix_ns - round(pair.lsl_s * NS_PER_S) == pytest.approx(expected_ns, abs=SAME_NS)
    # What comes after the node's own stream is found after it.
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo("other", "EEG", 1, 0.0, "float32", "other-id"))
    ros.until(lambda: "/biosensors/other/EEG" in ros.topics(), "the topic of another stream")
    assert not [topic for topic in ros.topics() if topic.endswith("lsl_to_ros/events")]
    del outlet
    assert running.signal(signal.SIGINT) == 0


@pytest.mark.parametrize(
    ("name", "domain", "expected"),
    [
        ("/lsl_to_ros", 0, "robot"),
        ("/lsl_to_ros", 7, "robot_domain7"),
        ("/left/lsl_to_ros", 0, "robot_left_lsl_to_ros"),
    ],
)
def test_nodes_of_one_computer_have_streams_of_their_own(
    name: str, domain: int, expected: str
) -> None:
    node: Any = _Named(name, domain)
    assert unit_of("robot", node) == expected


def _own_streams() -> list[pylsl.StreamInfo]:
    resolver = pylsl.ContinuousResolver()
    until_s = time.monotonic() + PATIENCE_S
    found: list[pylsl.StreamInfo] = []
    # A second one would be there within this time.
    settled_s = time.monotonic() + 3.0
    while time.monotonic() < settled_s or (not found and time.monotonic() < until_s):
        time.sleep(0.1)
        found = [info for info in resolver.results() if info.name().startswith(f"{NODE}-")]
    return found


# How long a node that was killed takes until its topics flow again.

# The requirement: all topics are open again so soon after the node was started.
RESTART_S = 2.0


def opened(node: RunningNode, name: str) -> float:
    """System time at which the node said that it has a topic."""
    (line,) = (line for line in node.log.splitlines() if f"biosensors/{name}/EEG (" in line)
    found = re.search(r"\[(\d+\.\d+)\]", line)
    assert found is not None
    return float(found[1])


@pytest.mark.alone
def test_a_killed_node_that_was_started_again_has_its_topics_in_two_seconds(
    ros: Ros, start_node: Callable[..., RunningNode], flow: Callable[..., Flow]
) -> None:
    names = ("kill_a", "kill_b", "kill_c")
    heard = [ros.listen(Float32MultiArray, f"/biosensors/{name}/EEG") for name in names]
    for name in names:
        info = pylsl.StreamInfo(name, "EEG", 1, 100.0, "float32", name)
        flow(pylsl.StreamOutlet(info), 100.0)
    topics: list[float] = []
    samples: list[float] = []
    for _ in range(4):
        for messages in heard:
            messages.clear()
        begun, watch = time.time(), Stopwatch()
        node = start_node()
        ros.until(lambda: all(heard), "samples of each stream")
        samples.append(watch.elapsed_s())
        stalled_s = watch.stalled_s()
        assert node.signal(signal.SIGKILL) == -signal.SIGKILL
        topics.append(max(opened(node, name) for name in names) - begun - stalled_s)
        # What is still on its way belongs to the node that was killed.
        ros.spin(0.2)
    # From the topic to the first sample, it is DDS that takes its time to match.
    print(f"topics: {', '.join(f'{one:.2f}' for one in topics)} s after the start")
    print(f"samples: {', '.join(f'{one:.2f}' for one in samples)} s after the start")
    assert median(topics) <= RESTART_S
