"""The quality of service of the node's topics, and how parameters override it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Float32, Float32MultiArray

from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet

if TYPE_CHECKING:
    from tests.ros.conftest import Flow, Ros

pytestmark = [pytest.mark.nightly, pytest.mark.usefixtures("node")]

KEPT = 3
OVERRIDES = {
    "/biosensors/hasty/EEG.publisher.reliability": "best_effort",
    "/biosensors/hasty/EEG_chunk.publisher.reliability": "best_effort",
    "/biosensors/kept/EEG.publisher.durability": "transient_local",
    "/biosensors/kept/EEG.publisher.depth": KEPT,
    "/biosensors/kept/EEG_chunk.publisher.durability": "transient_local",
    "/biosensors/kept/EEG_chunk.publisher.depth": 1,
    "/diagnostics.publisher.durability": "transient_local",
}
NODE_ARGUMENTS = (
    "--ros-args",
    *(
        part
        for name, value in OVERRIDES.items()
        for part in ("-p", f"qos_overrides.{name}:={value}")
    ),
)
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STREAMS = "/lsl_to_ros/streams"
# Sensor, data name, and which of its topics keep their last message.
STATES = [
    ("polar_h10", "bat", {"bat", "bat_state"}),
    ("polar_h10", "rssi", {"rssi"}),
    ("emotiv_insight", "dev", {"dev", "bat_state"}),
    ("polar_h10", "ecg", set[str]()),
    ("polar_h10", "hr", set[str]()),
    ("empatica_e4", "st", set[str]()),
]


def foreign(name: str, rate: float = 100.0) -> pylsl.StreamOutlet:
    return pylsl.StreamOutlet(pylsl.StreamInfo(name, "EEG", 1, rate, "float32", f"id of {name}"))


def declared(sensor_name: str, data: str, who: str) -> Outlet:
    identity = DeviceIdentity(sensor_name, "U1", participant=who)
    return Outlet(declaration(sensor_name).stream(data), identity, DeviceInfo())


def push_now(outlet: Outlet, sample: list[float]) -> None:
    """Push a state without the outlet's wait for receivers."""
    unchecked: pylsl.StreamOutlet = vars(outlet)["_outlet"]
    unchecked.push_sample(sample, pylsl.local_clock())


def test_every_topic_is_reliable_and_states_are_kept_for_late_subscribers(ros: Ros) -> None:
    outlets = [declared(name, data, "qos") for name, data, _ in STATES]
    other = foreign("other_program")
    ros.attached(*(f"/qos/biosensors/{name}/{data}" for name, data, _ in STATES))
    ros.attached("/biosensors/other_program/EEG")
    kept = {f"/qos/biosensors/{name}/{topic}" for name, _, kept in STATES for topic in kept}
    expected = {*kept, STREAMS, "/diagnostics"}

    def topics() -> set[str]:
        ours = ("/qos/", "/biosensors/other_program/", "/lsl_to_ros/", "/diagnostics")
        return {topic for topic in ros.topics() if topic.startswith(ours)}

    ros.until(lambda: len(topics()) >= 14 and expected <= topics(), "all topics")
    assert {f"/qos/biosensors/polar_h10/{data}" for data in ("ecg", "ecg_chunk")} <= topics()
    assert "/qos/biosensors/empatica_e4/st_temperature" in topics()

    def are_single() -> bool:
        # What a node of an earlier test has left in the graph stays there for a while.
        return all(len(ros.publishers(topic)) == 1 for topic in topics())

    ros.until(are_single, "one publisher of each topic")
    for topic in topics():
        (publisher,) = ros.publishers(topic)
        profile = publisher.qos_profile
        assert profile.reliability.name == "RELIABLE", topic
        is_kept = profile.durability.name == "TRANSIENT_LOCAL"
        assert is_kept is (topic in expected), topic
    del outlets, other


def test_a_late_subscriber_gets_the_battery_and_the_list_of_streams(ros: Ros) -> None:
    battery, heart = declared("polar_h10", "bat", "late"), declared("polar_h10", "hr", "late")
    base = "/late/biosensors/polar_h10"
    ros.attached(f"{base}/bat", f"{base}/hr")
    for level in (80.0, 79.0):
        push_now(battery, [level])
        assert heart.push([level], [pylsl.local_clock()]) is None

    def have_come() -> bool:
        found = [ros.status(f"{base}/{data}") for data in ("bat", "hr")]
        return all(status is not None and status["received"] == "2" for status in found)

    ros.until(have_come, "both samples of each at the node")
    raw = ros.listen(Float32, f"{base}/bat", LATCHED)
    state = ros.listen(BatteryState, f"{base}/bat_state", LATCHED)
    streams = ros.listen(DiagnosticArray, STREAMS, LATCHED)
    rates = ros.listen(Float32, f"{base}/hr")
    ros.until(lambda: bool(raw and state and streams), "what was kept")
    assert [message.data for message in raw] == [79.0]
    assert [message.percentage for message in state] == [pytest.approx(0.79)]
    assert f"{base}/bat" in [status.name for status in streams[-1].status]
    ros.attached(f"{base}/hr", readers=1)
    assert not rates


@pytest.mark.seam
def test_overrides_hold_for_raw_and_chunk_topics_and_for_diagnostics(
    ros: Ros, flow: Callable[..., Flow]
) -> None:
    outlet = foreign("hasty")
    assert ros.set("hasty.Chunk_Length", 5) == ""
    unreliable = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
    topic = "/biosensors/hasty/EEG"
    raw = ros.listen(Float32MultiArray, topic, unreliable)
    chunks = ros.listen(Float32MultiArray, f"{topic}_chunk", unreliable)
    ros.attached(topic, readers=2)
    for name in (topic, f"{topic}_chunk"):
        (publisher,) = ros.publishers(name)
        assert publisher.qos_profile.reliability.name == "BEST_EFFORT"
    flow(outlet, 100.0)
    ros.until(lambda: bool(raw and chunks), "samples and chunks")
    report = ros.listen(DiagnosticArray, "/diagnostics", LATCHED)
    ros.until(lambda: bool(report), "a report")
    (publisher,) = ros.publishers("/diagnostics")
    assert publisher.qos_profile.durability.name == "TRANSIENT_LOCAL"


def test_an_overridden_depth_is_what_a_late_subscriber_gets(ros: Ros) -> None:
    outlet = foreign("kept")
    topic = "/biosensors/kept/EEG"
    assert ros.set("kept.Chunk_Length", 2) == ""
    first: list[list[Any]] = [
        ros.listen(Float32MultiArray, name, LATCHED) for name in (topic, f"{topic}_chunk")
    ]
    ros.attached(topic, readers=2)
    begun = pylsl.local_clock()
    for number in range(10):
        outlet.push_sample([float(number)], begun + number / 100)
    ros.until(lambda: [len(heard) for heard in first] == [10, 5], "ten samples, five chunks")
    raw = ros.listen(Float32MultiArray, topic, LATCHED)
    chunks = ros.listen(Float32MultiArray, f"{topic}_chunk", LATCHED)
    ros.attached(topic, readers=4)
    ros.until(lambda: len(raw) >= KEPT and bool(chunks), "what was kept")
    assert [list(message.data) for message in raw] == [[7.0], [8.0], [9.0]]
    assert [list(message.data) for message in chunks] == [[8.0, 9.0]]
