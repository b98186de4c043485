"""The running node says what is too much, for itself and for who reads its topics."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pylsl
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float32MultiArray

if TYPE_CHECKING:
    from tests.ros.conftest import Flow, Ros, RunningNode

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("node")]

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
    expected = ("messages a second", f"read {topic}_chunk instead", "plotter: best effort")
    ros.until(lambda: says(ros, topic, *expected), "the topic is too fast")
    pushed = flowing.stop()

    def is_told() -> bool:
        status = ros.status(topic)
        return status is not None and status["published"] == status["received"] == str(pushed)

    ros.until(is_told, "what was published is counted")
    ros.until(lambda: not says(ros, topic, "messages a second"), "it is over")
    load = ros.status("node")
    assert load is not None
    assert float(load["cpu_percent"]) > 0.0
    assert ros.set("burst_pacing", 0.5) == ""


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
        return have_waited and says(ros, "node", "data have waited", "Sensor_Enable")

    ros.until(are_told, "data wait")
    ros.until(lambda: node.count("data have waited") >= 1, "the log says it, too")
    assert ros.set("burst_pacing", 0.0) == ""
    ros.until(lambda: len(heard) == QUEUED, "all samples")
    ros.until(lambda: not says(ros, "node", "data have waited"), "nothing waits any more")
    assert ros.set("burst_pacing", 0.5) == ""
