"""The quality of service of the node's topics, and how parameters override it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import BatteryState
from std_msgs.msg import (
    Empty,
    Float32,
    Float32MultiArray,
    String,
    UInt8,
)

from biosensor_common.naming import sanitise
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.streaming.outlets import Outlet

if TYPE_CHECKING:
    from tests.ros.conftest import Flow, Ros, RunningNode

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


# What the running node publishes of streams, its own kind and others.


def foreign_stream(
    name: str, kind: str, channels: int, rate: float, format_: str
) -> pylsl.StreamOutlet:
    info = pylsl.StreamInfo(name, kind, channels, rate, format_, f"id of {sanitise(name)} {kind}")
    return pylsl.StreamOutlet(info)


def layout(message: Any) -> list[tuple[str, int, int]]:
    return [(dim.label, dim.size, dim.stride) for dim in message.layout.dim]


@pytest.mark.seam
def test_chunks_hold_what_the_raw_topic_holds_whatever_their_length(ros: Ros) -> None:
    outlet = foreign_stream("lengths", "EEG", 2, 100.0, "float32")
    topic = "/biosensors/lengths/EEG"
    raw = ros.listen(Float32MultiArray, topic)
    chunks = ros.listen(Float32MultiArray, f"{topic}_chunk")
    ros.attached(topic, readers=2)
    pushed: list[list[float]] = []
    start = pylsl.local_clock()
    lengths = (50, 64, 7, 1, 20)
    for length in lengths:
        assert ros.set("lengths.EEG.Chunk_Length", length) == ""
        new = [[float(number), -float(number)] for number in range(len(pushed), len(pushed) + 95)]
        stamps = [start + (len(pushed) + number) * 0.01 for number in range(len(new))]
        outlet.push_chunk(new, stamps)
        pushed += new
        count = len(pushed)
        ros.until(lambda count=count: len(raw) >= count, "all samples raw")
    assert [list(message.data) for message in raw] == pushed
    flat = [value for sample in pushed for value in sample]
    # 475 samples; the last length leaves less than 20 of them waiting.
    ros.until(lambda: sum(len(chunk.data) for chunk in chunks) > len(flat) - 40, "all full chunks")
    assert [value for chunk in chunks for value in chunk.data] == flat[: len(flat) // 40 * 40]
    sizes = [chunk.layout.dim[0].size for chunk in chunks]
    assert sorted(set(sizes)) == sorted(lengths)
    assert sizes[0] == 50
    for chunk, size in zip(chunks, sizes, strict=True):
        assert layout(chunk) == [("samples", size, size * 2), ("channels", 2, 2)]
        assert len(chunk.data) == size * 2


def test_a_chunk_never_spans_a_gap(ros: Ros) -> None:
    outlet = declared("polar_h10", "ecg", "gap")
    topic = "/gap/biosensors/polar_h10/ecg"
    assert ros.set("gap.polar_h10.ecg.Chunk_Length", 10) == ""
    raw = ros.listen(Float32, topic)
    chunks = ros.listen(Float32MultiArray, f"{topic}_chunk")
    ros.attached(topic, readers=2)
    now = pylsl.local_clock()
    before = [now - 5.0 + number / 130 for number in range(25)]
    after = [now - 2.0 + number / 130 for number in range(10)]
    assert outlet.push(range(35), before + after) is None
    ros.until(lambda: len(chunks) >= 3, "three chunks")
    assert [list(chunk.data) for chunk in chunks] == [
        list(range(10)),
        list(range(10, 20)),
        list(range(25, 35)),
    ]
    assert layout(chunks[0]) == [("samples", 10, 10), ("channels", 1, 1)]
    ros.until(lambda: len(raw) >= 35, "all samples raw")
    assert [message.data for message in raw] == list(range(35))
    ros.report()
    status = ros.status(topic)
    assert status is not None
    assert status["chunk_discarded"] == "5"
    assert status["received"] == "35"


def test_text_that_is_not_utf_8_neither_stops_nor_loses_anything(ros: Ros) -> None:
    outlet = foreign_stream("latin", "Markers", 1, 0.0, "string")
    heard = ros.listen(String, "/biosensors/latin/Markers")
    ros.attached("/biosensors/latin/Markers", readers=1)
    for text in (b"before", "caf\xe9".encode("latin-1"), "caf\xe9".encode()):
        outlet.push_sample([text], pylsl.local_clock())
    ros.until(lambda: len(heard) >= 3, "three markers")
    assert [message.data for message in heard] == ["before", "caf\xe9", "caf\xe9"]


@pytest.mark.seam
def test_no_stamp_stops_a_stream(ros: Ros) -> None:
    outlet = foreign_stream("stamps", "EEG", 1, 100.0, "float32")
    raw = ros.listen(Float32MultiArray, "/biosensors/stamps/EEG")
    ros.attached("/biosensors/stamps/EEG", readers=1)
    stamps = [pylsl.local_clock(), math.inf, math.nan, 1e308, -1e308, pylsl.local_clock()]
    for number, stamp in enumerate(stamps):
        outlet.push_sample([float(number)], stamp)
    ros.until(lambda: len(raw) >= len(stamps), "all samples")
    assert [message.data[0] for message in raw] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]


@pytest.mark.seam
def test_declared_streams_have_their_declared_types(ros: Ros) -> None:
    cases: list[tuple[str, str, type[Any], list[float], Callable[[Any], Any]]] = [
        ("zephyr", "hr", UInt8, [72], lambda message: message.data),
        ("polar_h10", "acc", Float32MultiArray, [0.5, -1, 2], lambda message: list(message.data)),
        ("polar_h10", "ibi", Float32, [0.75], lambda message: message.data),
    ]
    opened: list[tuple[Outlet, list[Any], str]] = []
    for name, data, message_class, _, _ in cases:
        topic = f"/types/biosensors/{name}/{data}"
        opened.append((declared(name, data, "types"), ros.listen(message_class, topic), topic))
    tag = declared("empatica_e4", "tag", "types")
    presses = ros.listen(Empty, "/types/biosensors/empatica_e4/tag")
    topics = [topic for _, _, topic in opened]
    ros.attached(*topics, "/types/biosensors/empatica_e4/tag", readers=1)
    for (outlet, heard, topic), (_, _, _, sample, read) in zip(opened, cases, strict=True):
        assert outlet.push([sample], [pylsl.local_clock()]) is None
        ros.until(lambda heard=heard: bool(heard), f"a sample on {topic}")
        expected = sample if len(sample) > 1 else sample[0]
        assert read(heard[0]) == expected
    status = ros.status("/types/biosensors/polar_h10/acc")
    assert status is not None
    assert (status.unit, status["unit_of_measurement"]) == ("U1", "g")
    assert (status["sensor"], status["participant"]) == ("polar_h10", "types")
    assert status["rate_nominal"] == "50.00"
    tag.push_text("pressed", pylsl.local_clock())
    ros.until(lambda: bool(presses), "a press of the button")


def test_a_value_that_does_not_fit_is_counted_and_said_once(ros: Ros, node: RunningNode) -> None:
    # The agent's check would refuse it, so this is an outlet that does not check.
    stream = declaration("zephyr").stream("hr")
    identity = DeviceIdentity("zephyr", "U1", participant="unfit")
    good = Outlet(stream, identity, DeviceInfo())
    topic = "/unfit/biosensors/zephyr/hr"
    heard = ros.listen(UInt8, topic)
    ros.attached(topic, readers=1)
    unchecked: pylsl.StreamOutlet = vars(good)["_outlet"]
    for value in (60, 300, -1, 61):
        unchecked.push_sample([value], pylsl.local_clock())
    ros.until(lambda: len(heard) >= 2, "the samples that fit")
    ros.report()
    assert [message.data for message in heard] == [60, 61]
    status = ros.status(topic)
    assert status is not None
    assert status["unfit"] == "2"
    assert node.count("zephyr hr", "not published") == 1
