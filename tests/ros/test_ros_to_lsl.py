"""The node ``ros_to_lsl``, from real publishers to real inlets, whatever their clocks."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import statistics
import subprocess
import sys
import time
from array import array
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import BatteryState, Image, JointState
from std_msgs.msg import Empty, Float64, String

from tests.rigs.compiler import compile_c

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode

# Above those that tests run in (tests/slots.py).
OTHER_DOMAIN = 36
pytestmark = pytest.mark.nightly

# The node ``ros_to_lsl``, from real publishers to real inlets.

MODULE = "lsl_to_ros.ros_to_lsl.node"
DEADLINE_S = 30.0
BEST_EFFORT = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
Start = Callable[..., "RunningNode"]


class Streams:
    """What the node offers to LSL."""

    def __init__(self, ros: Ros) -> None:
        self._ros = ros
        self._resolver = pylsl.ContinuousResolver()

    def names(self) -> set[str]:
        return {info.name() for info in self._resolver.results()}

    def open(self, name: str, other_than: Stream | None = None) -> Stream:
        """Wait for a stream of a name, and open it."""
        known = other_than.source_id if other_than else ""

        def found() -> list[pylsl.StreamInfo]:
            results = self._resolver.results()
            return [each for each in results if each.name() == name and each.source_id() != known]

        self._ros.until(lambda: bool(found()), f"a stream {name}")
        return Stream(self._ros, pylsl.StreamInlet(found()[0], recover=False))


class Stream:
    """One of its streams, received from now on."""

    def __init__(self, ros: Ros, inlet: pylsl.StreamInlet) -> None:
        self._ros, self._inlet = ros, inlet
        inlet.open_stream(DEADLINE_S)
        self.header = ElementTree.fromstring(inlet.info(DEADLINE_S).as_xml())
        self.samples: list[list[Any]] = []
        self.stamps: list[float] = []

    @property
    def source_id(self) -> str:
        return self.header.findtext("source_id") or ""

    @property
    def labels(self) -> list[str | None]:
        return [each.text for each in self.header.findall("desc/channels/channel/label")]

    def of_ros(self, name: str) -> str:
        return self.header.findtext(f"desc/ros/{name}") or ""

    def until(self, holds: Callable[[], bool], expected: str) -> None:
        def look() -> bool:
            samples, stamps = self._inlet.pull_chunk(timeout=0.0, max_samples=1024)
            self.samples += [list(each) for each in samples]
            self.stamps += list(stamps)
            return holds()

        self._ros.until(look, expected)

    def until_sent(self, publish: Callable[[], None], holds: Callable[[], bool]) -> None:
        """Publish again and again until something has come."""

        def look() -> bool:
            publish()
            return holds()

        self.until(look, "what is published")


@pytest.fixture
def streams(ros: Ros) -> Iterator[Streams]:
    yield Streams(ros)


def arguments(topics: str, *more: str) -> list[str]:
    given = (f"topics:=[{topics}]", *more)
    return ["--ros-args", *(word for each in given for word in ("-p", each))]


def stamped_now(message: Any, offset_s: float = 0.0) -> Any:
    now_ns = time.time_ns() + round(offset_s * 1e9)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, 10**9)
    return message


def joints(*names: str) -> JointState:
    return stamped_now(JointState(name=list(names), position=array("d", range(len(names)))))


@pytest.mark.seam
def test_joints_are_a_stream_with_their_names_and_a_new_one_when_they_change(
    ros: Ros, streams: Streams, start_node: Start
) -> None:
    names = ["shoulder", "elbow"]
    ros.publish(lambda: joints(*names), "/arm/joint_states")
    node = start_node(*arguments("/arm/joint_states"), module=MODULE)
    first = streams.open("arm-joint_states")
    assert first.labels == ["shoulder.position", "elbow.position"]
    assert first.header.findtext("channel_format") == "double64"
    assert first.of_ros("topic") == "/arm/joint_states"
    assert first.of_ros("type") == "sensor_msgs/msg/JointState"
    assert first.of_ros("type_hash").startswith("RIHS01_")
    assert (first.of_ros("stamp_source"), first.of_ros("clock")) == ("header", "synchronised")
    before = pylsl.local_clock()
    first.until(lambda: bool(first.stamps) and first.stamps[-1] > before, "samples of now")
    assert first.samples[-1] == [0.0, 1.0]
    assert first.stamps[-1] < pylsl.local_clock()

    names.append("wrist")
    second = streams.open("arm-joint_states", other_than=first)
    ros.until(lambda: ros_value(ros, "/arm/joint_states", "replaced") == "1", "that it is counted")
    assert second.labels == ["shoulder.position", "elbow.position", "wrist.position"]
    assert node.count("its sequences have changed: 3 channels now") == 1
    assert node.signal(signal.SIGINT) == 0
    assert "Traceback" not in node.log


def ros_value(ros: Ros, topic: str, key: str) -> str:
    status = ros.status(topic)
    return status[key] if status is not None else ""


@pytest.mark.seam
def test_a_marker_that_is_published_once_is_in_the_stream_at_its_time(
    ros: Ros, streams: Streams, start_node: Start
) -> None:
    options = ("/trial.as:=markers", "/go.as:=markers", "/go.type:=std_msgs/msg/Empty")
    start_node(*arguments("/trial, /go", *options), module=MODULE)
    # Nobody publishes them yet, and a recorder sees them all the same.
    trial, go = streams.open("trial"), streams.open("go")
    assert go.of_ros("type") == "std_msgs/msg/Empty"
    go.until(lambda: go.samples == [["ros_to_lsl ready"]], "that the stream is there")
    ready = ros.node.create_publisher(Empty, "/go", 1)
    ros.until(lambda: ready.get_subscription_count() == 1, "a subscriber")
    ready.publish(Empty())
    go.until(lambda: go.samples[1:] == [["/go"]], "a marker")

    publisher = ros.node.create_publisher(String, "/trial", 1)
    ros.until(lambda: publisher.get_subscription_count() == 1, "a subscriber")
    before = pylsl.local_clock()
    publisher.publish(String(data="trial 1"))
    after = pylsl.local_clock()
    trial.until(lambda: ["trial 1"] in trial.samples, "a marker")
    stamp = trial.stamps[trial.samples.index(["trial 1"])]
    assert before - 0.001 < stamp < after + 0.001


def test_the_text_of_a_latched_topic_reaches_who_comes_later_once(
    ros: Ros, streams: Streams, start_node: Start
) -> None:
    latched = ros.node.create_publisher(String, "/condition", LATCHED)
    event = ros.node.create_publisher(String, "/event", 1)
    latched.publish(String(data="night"))
    start_node(*arguments("/condition, /event"), module=MODULE)
    ros.until(lambda: event.get_subscription_count() == 1, "a subscriber")
    event.publish(String(data="over"))
    for topic in ("/condition", "/event"):
        ros.until(lambda name=topic: ros_value(ros, name, "pushed") == "1", "a marker")
    condition, events = streams.open("condition"), streams.open("event")
    condition.until(lambda: ["night"] in condition.samples, "the condition that still holds")
    assert condition.samples == [["ros_to_lsl ready"], ["night"]]
    event.publish(String(data="again"))
    events.until(lambda: ["again"] in events.samples, "a marker")
    assert ["over"] not in events.samples


def test_a_clock_that_is_wrong_is_said_everywhere_and_not_used(
    ros: Ros, streams: Streams, start_node: Start
) -> None:
    ros.publish(lambda: stamped_now(PoseStamped(), offset_s=3600.0), "/hand", BEST_EFFORT)
    node = start_node(*arguments("/hand"), module=MODULE)
    hand = streams.open("hand")
    assert (hand.of_ros("stamp_source"), hand.of_ros("clock")) == ("source", "wrong")
    assert float(hand.of_ros("clock_edge_s")) == pytest.approx(-3600, abs=1)
    assert hand.header.findtext("type") == "MoCap"
    hand.until(lambda: bool(hand.stamps), "a sample")
    assert hand.stamps[0] == pytest.approx(pylsl.local_clock(), abs=5)
    ros.until(lambda: ros_status(ros, "/hand").level == DiagnosticStatus.WARN, "a warning")
    told = ros_status(ros, "/hand").message
    assert float(told.split(" s ahead of")[0].rpartition(" ")[2]) == pytest.approx(3600, abs=1)
    # The log is written by a thread of its own.
    said = ("/hand", "ahead of this computer's time")
    ros.until(lambda: node.count(*said) > 0, "a line of the log")
    assert node.count(*said) == 1


def ros_status(ros: Ros, topic: str) -> Any:
    ros.until(lambda: ros.status(topic) is not None, f"{topic} in /diagnostics")
    return ros.status(topic)


def said_of(ros: Ros, topic: str) -> str:
    status = ros.status(topic)
    return status.message if status else ""


def test_publishers_of_another_quality_are_heard_too(
    ros: Ros, streams: Streams, start_node: Start
) -> None:
    ros.publish(lambda: Float64(data=1.0), "/level")
    start_node(*arguments("/level"), module=MODULE)
    level = streams.open("level")
    level.until(lambda: bool(level.samples), "a sample")
    ros.until(lambda: ros_value(ros, "/level", "lost") == "0", "no loss")
    ros.publish(lambda: Float64(data=2.0), "/level", BEST_EFFORT)
    level.until(lambda: [2.0] in level.samples, "what is published with best effort")
    count = len(level.samples)
    level.until(lambda: [1.0] in level.samples[count:], "what is published reliably")
    # Two publishers count each for itself.
    ros.until(lambda: ros_value(ros, "/level", "lost") == "unknown", "that nobody knows")
    assert ros_value(ros, "/level", "quality_of_service") == "best effort, volatile"
    ros.until(lambda: "mixed in one stream" in said_of(ros, "/level"), "that they are mixed")


@pytest.mark.parametrize(
    "of_the_other",
    [
        pytest.param(["/level"], id="alike"),
        pytest.param(["/level", "-r", "__node:=other"], id="with another node name"),
        pytest.param(["/height", "-p", "/height.name:=level", "-r", "__node:=other"], id="renamed"),
    ],
)
def test_a_node_that_was_started_twice_says_so(
    of_the_other: list[str], ros: Ros, streams: Streams, start_node: Start
) -> None:
    topic, *options = of_the_other
    for each in {"/level", topic}:
        ros.publish(lambda: Float64(data=1.0), each)
    start_node(*arguments("/level"), module=MODULE)
    streams.open("level").until(lambda: said_of(ros, "/level") == "sending", "one that sends")
    start_node(*arguments(topic), *options, module=MODULE)
    ros.until(lambda: "another ros_to_lsl also sends it" in said_of(ros, "/level"), "another one")


def test_two_robots_that_send_a_topic_of_one_name_are_told_apart(
    ros: Ros, streams: Streams, start_node: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    ros.publish(lambda: Float64(data=1.0), "/level")
    start_node(*arguments("/level"), module=MODULE)
    streams.open("level").until(lambda: said_of(ros, "/level") == "sending", "one that sends")
    # The other robot has a ROS domain of its own, so ROS knows nothing of it.
    monkeypatch.setenv("ROS_DOMAIN_ID", str(OTHER_DOMAIN))
    start_node(*arguments("/level", "/level.as:=markers"), module=MODULE)
    said = "sends a different stream of the name level"
    ros.until(lambda: said in said_of(ros, "/level"), "the other one")


def test_text_beside_numbers_is_a_stream_of_markers_of_its_changes(
    ros: Ros, streams: Streams, start_node: Start
) -> None:
    state = BatteryState(voltage=12.5, percentage=math.nan)
    state.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_CHARGING
    publisher = ros.node.create_publisher(BatteryState, "/battery", LATCHED)
    publisher.publish(state)
    start_node(*arguments("/battery"), module=MODULE)
    numbers, text = streams.open("battery"), streams.open("battery__text")
    assert "voltage" in numbers.labels
    numbers.until_sent(lambda: publisher.publish(state), lambda: bool(numbers.samples))
    assert numbers.samples[0][numbers.labels.index("voltage")] == 12.5
    assert math.isnan(numbers.samples[0][numbers.labels.index("percentage")])
    state.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_FULL
    text.until_sent(lambda: publisher.publish(state), lambda: '"FULL"' in str(text.samples))
    changes = [json.loads(each) for (each,) in text.samples if each.startswith("{")]
    # What is latched is sent again to whoever came later, unless it has changed by then.
    states = [each["power_supply_status"] for each in changes]
    assert states in (["FULL"], ["CHARGING", "FULL"])


def test_everything_small_is_sent_and_nothing_goes_in_a_circle(
    ros: Ros, streams: Streams, start_node: Start
) -> None:
    # An LSL stream of somebody else, which lsl_to_ros publishes.
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo("amp", "EEG", 1, 0, "double64", "amp-1"))
    start_node()
    amp = "/biosensors/amp/EEG"
    ros.until(lambda: bool(ros.publishers(amp)), "a topic of lsl_to_ros")
    ros.publish(lambda: Float64(data=4.0), "/level")
    ros.publish(Image, "/camera")
    explicit = start_node(*arguments(amp, "all_small:=true"), module=MODULE)
    sent = streams.open("level")
    sent.until(lambda: [4.0] in sent.samples, "a sample")
    # By then both nodes have looked at all of it several times.
    ros.spin(3.0)
    names = streams.names()
    assert {"level", "amp"} <= names
    assert not {name for name in names if "biosensors" in name or "camera" in name}
    assert not any(name in names for name in ("diagnostics", "rosout", "lsl_to_ros-streams"))
    assert not any("level" in topic for topic in ros.topics() if topic.startswith("/biosensors"))
    assert not any("ros_to_lsl" in topic for topic in ros.topics() if "/biosensors" in topic)
    assert explicit.count(amp, "lsl_to_ros publishes it") == 1
    del outlet


def test_a_type_that_is_not_installed_is_said_and_the_others_go_on(
    ros: Ros, streams: Streams, start_node: Start
) -> None:
    ros.publish(lambda: Float64(data=5.0), "/level")
    more = ("/face.type:=hri_msgs/msg/FacialLandmarks", "/pose.fields:=[position]")
    node = start_node(*arguments("/level, /face, /pose, /levels", *more), module=MODULE)
    ros.publish(lambda: stamped_now(PoseStamped()), "/pose")
    sent = streams.open("level")
    sent.until(lambda: [5.0] in sent.samples, "a sample")
    ros.until(lambda: ros_status(ros, "/face").level == DiagnosticStatus.ERROR, "an error")
    assert "hri_msgs/msg/FacialLandmarks is not installed" in ros_status(ros, "/face").message
    ros.until(lambda: ros_status(ros, "/pose").level == DiagnosticStatus.ERROR, "an error")
    assert "'position'" in ros_status(ros, "/pose").message
    ros.until(lambda: node.count("/levels: nothing publishes it yet") == 1, "a hint")
    ros.until(lambda: ros_status(ros, "/levels").level == DiagnosticStatus.WARN, "a warning")
    assert node.is_running


@pytest.mark.seam
def test_what_is_wrong_ends_it_with_one_sentence(start_node: Start) -> None:
    simulated = start_node(*arguments("/a", "use_sim_time:=true"), module=MODULE)
    unreadable = start_node("--ros-args", "-p", "topics:=[", module=MODULE)
    empty = start_node("--ros-args", "-p", "topics:=[]", module=MODULE)
    shown = start_node("--help", module=MODULE)
    for node in (simulated, unreadable, empty):
        assert node.wait() == 2
        assert "Traceback" not in node.log
        assert node.count("ros_to_lsl:") == 1
    assert "simulated time cannot be converted to the LSL clock" in simulated.log
    assert shown.wait() == 0
    assert "all_small" in shown.log


def test_what_is_wrong_while_it_runs_is_refused_with_the_reason(
    ros: Ros, start_node: Start
) -> None:
    start_node(*arguments("/a"), module=MODULE)
    ros.until(lambda: ros.status("/a") is not None, "its first report")
    wrong: list[tuple[str, bool | float | str, str]] = [
        ("all_smal", True, "all_small is"),
        ("/b.rate", 4.0, "/b is not among the topics"),
        ("/a.rates", 4.0, "a topic has no 'rates'"),
        ("use_sim_time", True, "simulated time cannot be converted"),
        ("topics", "/b", "read-only"),
    ]
    for name, value, reason in wrong:
        assert reason in ros.set(name, value, node="/ros_to_lsl")
    assert ros.set("use_sim_time", value=False, node="/ros_to_lsl") == ""


# Robots whose clock is not this computer's, from their messages to the stamps in LSL.
SOURCE = Path(__file__).parents[1] / "rigs" / "shifted_clock.c"
ARGUMENTS = ("--ros-args", "-p", "topics:=[/pose, /vel]")
END_S = 30.0
SAMPLES = 40


@pytest.fixture
def start_robot(tmp_path: Path) -> Iterator[Callable[..., None]]:
    """Start a robot whose time of day is so many milliseconds off."""
    library = tmp_path / "shifted_clock.so"
    compile_c(SOURCE, library, "-shared", "-fPIC")
    robots: list[subprocess.Popen[bytes]] = []

    def start(shift_ms: int, *arguments: str, sawtooth_ms: int = 0) -> None:
        command = [sys.executable, "-m", "tests.rigs.shifted_publisher", *arguments]
        shifted = {"SHIFT_MS": str(shift_ms), "SAWTOOTH_MS": str(sawtooth_ms)}
        shifted["LD_PRELOAD"] = str(library)
        robots.append(subprocess.Popen(command, env=os.environ | shifted))

    yield start
    for robot in robots:
        robot.kill()
        robot.wait(END_S)


def stamps_off_s(ros: Ros, name: str, column: str) -> tuple[float, ElementTree.Element]:
    """Return by how much the stamps of a stream are off the true time, and its header."""
    resolver = pylsl.ContinuousResolver(prop="name", value=name)
    ros.until(lambda: bool(resolver.results()), f"a stream {name}")
    inlet = pylsl.StreamInlet(resolver.results()[0])
    inlet.open_stream(END_S)
    header = ElementTree.fromstring(inlet.info(END_S).as_xml())
    labels = [each.text for each in header.findall("desc/channels/channel/label")]
    place, off = labels.index(column), list[float]()
    # LSL's clock is the monotonic one, from another origin.
    origin_s = pylsl.local_clock() - time.monotonic()

    def take() -> bool:
        samples, stamps = inlet.pull_chunk(timeout=0.0, max_samples=1024)
        both = zip(samples, stamps, strict=True)
        off.extend(stamp - sample[place] - origin_s for sample, stamp in both)
        return len(off) >= SAMPLES

    ros.until(take, f"samples of {name}")
    return statistics.median(off), header


ROBOTS = [
    (-500, (), "wrong", r"(\d\.\d+) s behind this computer's time, as measured"),
    (-500, ("deaf",), "behind", r"behind by up to (\d\.\d+) s"),
    (-40, (), "wrong", r"(\d\.\d+) s behind this computer's time, as measured"),
    (0, (), "synchronised", ""),
]


@pytest.mark.parametrize(("shift_ms", "arguments", "word", "sentence"), ROBOTS)
def test_no_stamp_is_of_a_clock_that_is_behind(
    ros: Ros,
    start_node: Callable[..., RunningNode],
    start_robot: Callable[..., None],
    shift_ms: int,
    arguments: tuple[str, ...],
    word: str,
    sentence: str,
) -> None:
    start_robot(shift_ms, *arguments)
    start_node(*ARGUMENTS, module="lsl_to_ros.ros_to_lsl.node")
    for name, column in (("pose", "pose.position.y"), ("vel", "linear.y")):
        off_s, header = stamps_off_s(ros, name, column)
        assert abs(off_s) < 0.02
        assert abs(float(header.findtext("desc/ros/clock_edge_s", "")) + shift_ms / 1000) < 0.02

        def is_said(topic: str = f"/{name}") -> bool:
            status = ros.status(topic)
            if status is None or word not in status["clock_source"]:
                return False
            found = re.search(sentence, status.message)
            return found is not None and (
                not found.groups() or abs(float(found[1]) + shift_ms / 1000) < 0.02
            )

        ros.until(is_said, f"{word!r} in /diagnostics")


@pytest.mark.parametrize("sawtooth_ms", [1000, 20_000])
def test_a_clock_in_a_sawtooth_is_not_called_synchronised(
    ros: Ros,
    start_node: Callable[..., RunningNode],
    start_robot: Callable[..., None],
    sawtooth_ms: int,
) -> None:
    start_robot(-200, sawtooth_ms=sawtooth_ms)
    start_node(*ARGUMENTS, module="lsl_to_ros.ros_to_lsl.node")
    for name, column in (("pose", "pose.position.y"), ("vel", "linear.y")):

        def is_doubted(topic: str = f"/{name}") -> bool:
            status = ros.status(topic)
            return status is not None and status["clock_source"].startswith(("behind", "wrong"))

        def stays_doubted(is_doubted: Callable[[], bool] = is_doubted) -> bool:
            if not is_doubted():
                return False
            ros.spin(2.0)
            return is_doubted()

        # Where the test begins within a slow sawtooth, its first reset may come soon and be
        # believed; a clock that falls behind twice is not trusted again.
        ros.until(stays_doubted, "a clock that stays behind or wrong")
        off_s, _ = stamps_off_s(ros, name, column)
        # The first time that it is set, it may have been the way: noticed after some seconds.
        assert abs(off_s) < 0.05
