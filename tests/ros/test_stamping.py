"""Stamps of a sender become ROS times: those that wait for its clock, too."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pylsl
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import Temperature
from std_msgs.msg import Float32, Float32MultiArray

from biosensor_common.lsl.inlet import Block
from biosensor_common.quantities import MessageType
from biosensor_common.refusal import Refusals
from biosensor_common.ros.standard_messages import standard_messages
from biosensor_common.ros_clock import NS_PER_S
from biosensor_gateway.streaming.counters import Counters, counters_text
from lsl_to_ros.parameters.streams import StreamSettings
from lsl_to_ros.statistics.losses import NodeCounters
from lsl_to_ros.statistics.ros_time import RosTime, Stamping
from lsl_to_ros.topics import bridge as bridge_module
from lsl_to_ros.topics.bridge import Bridge, Outputs
from lsl_to_ros.topics.writers import CountersWriter, NumberWriter, StandardMessageWriter
from tests.rigs.recorded_topics import Clocks, RecordedPublisher, header_of, message_time

if TYPE_CHECKING:
    from tests.ros.conftest import Ros, RunningNode


# Stamps of a sender become ROS times, or are known to be none.

STAMPS = [
    *(0.0, 1.0, 12345.678901234, -1.0, -1e5, 1e5, 3e8),
    *(2.0**31, -(2.0**31), 3e9, 1.7e12, 1.7e18, 9.3e18, 1e300, -1e300),
    *(math.nan, math.inf, -math.inf),
]


def nanoseconds(clocks: Clocks, stamp: float) -> int:
    (found,) = clocks.to_ns(np.array([stamp])).tolist()
    return found


@pytest.mark.nightly
def test_now_is_now(ros: Ros) -> None:
    offset = 1234.5
    clocks = Clocks(ros.node, offset)
    before = time.time_ns()
    stamp = pylsl.local_clock() - offset
    after = time.time_ns()
    # As exact as the offset of the two clocks is measured, see test_ros_clock.
    tolerance_ns = 1_000_000
    assert before - tolerance_ns <= nanoseconds(clocks, stamp) <= after + tolerance_ns


@pytest.mark.nightly
def test_the_distance_of_two_stamps_is_kept(ros: Ros) -> None:
    clocks = Clocks(ros.node, 0.25)
    start = nanoseconds(clocks, 1000.0)
    for step in (1, 3, 1024, 10**6):
        distance = nanoseconds(clocks, 1000.0 + step / 1024) - start
        assert abs(distance - step * 1e9 / 1024) <= 1


@pytest.mark.nightly
@pytest.mark.parametrize("stamp", STAMPS)
def test_what_is_said_to_be_a_time_is_one(ros: Ros, stamp: float) -> None:
    clocks = Clocks(ros.node, 12.5)
    (is_time,) = clocks.are_times(np.array([stamp]))
    since_1970 = time.time() - pylsl.local_clock() + 12.5 + stamp
    assert bool(is_time) is bool(0 <= since_1970 < 2**31)
    if is_time:
        assert nanoseconds(clocks, stamp) / 1e9 == pytest.approx(since_1970, abs=1.0)


@pytest.mark.nightly
def test_many_are_judged_at_once(ros: Ros) -> None:
    clocks = Clocks(ros.node, 12.5)
    singly = [bool(clocks.are_times(np.array([stamp]))[0]) for stamp in STAMPS]
    assert clocks.are_times(np.array(STAMPS)).tolist() == singly
    assert True in singly
    assert False in singly


@pytest.mark.nightly
def test_nothing_is_said_before_the_senders_clock_is_known(ros: Ros) -> None:
    clocks = Clocks(ros.node, None)
    assert not clocks.is_known
    with pytest.raises(ValueError, match="clock"):
        clocks.to_ns(np.array([1.0]))
    with pytest.raises(ValueError, match="clock"):
        clocks.local(1.0)
    with pytest.raises(ValueError, match="clock"):
        clocks.are_times(np.array([1.0]))
    clocks.correction = 2.0
    assert clocks.is_known
    assert clocks.local(1.0) == 3.0


@pytest.mark.nightly
def test_in_simulated_time_a_sample_has_the_time_of_its_receipt(ros: Ros) -> None:
    assert ros is not None
    node = Node("simulated", parameter_overrides=[Parameter("use_sim_time", value=True)])
    clocks = Clocks(node, 0.0)
    # No clock has been published.
    assert nanoseconds(clocks, 5.0) == nanoseconds(clocks, 1e300) == 0
    judged = clocks.are_times(np.array([5.0, 1e300, math.nan]))
    assert judged.tolist() == [True, True, False]
    node.destroy_node()


# What needs a sender's clock waits for it, and what has piled up goes out in order.
# What needs a sender's clock waits for it, and then goes out once and in order.

SETTINGS = StreamSettings(raw=True, chunk=True, chunk_length=4)
OFFSET_S = 12.5


class Skin:
    """Skin temperature, which has a raw topic and one with a stamp."""

    def __init__(self, ros: Ros, correction: float | None = None) -> None:
        header = header_of("zephyr", "st")
        self.clocks = Clocks(ros.node, correction)
        self.raw, self.timed = RecordedPublisher(Float32), RecordedPublisher(Temperature)
        self.warnings: list[str] = []
        self.counters = NodeCounters(refusals=Refusals(self.warnings.append))
        refusals = self.counters.refusals
        (temperature,) = standard_messages(header, "zephyr")
        outputs = Outputs(
            raw=NumberWriter(self.raw, MessageType.FLOAT32, 1, refusals),
            timed=[StandardMessageWriter(self.timed, temperature, self.clocks)],
        )
        self.bridge = Bridge(header, outputs, SETTINGS, self.counters, self.clocks)

    def send(self, *stamps: float) -> None:
        """Send a block of samples that have their stamps as values."""
        values = np.array(stamps)[:, np.newaxis]
        self.bridge.receive(Block(values, np.array(stamps)))

    def measure(self) -> None:
        self.clocks.correction = OFFSET_S
        self.bridge.clock_known()

    def expect(self, *stamps: float) -> None:
        messages = self.timed.messages
        assert [message.temperature for message in messages] == list(stamps)
        times = [message_time(self.clocks.ros_time.to_ns(stamp + OFFSET_S)) for stamp in stamps]
        assert [message.header.stamp for message in messages] == times


@pytest.fixture
def skin(ros: Ros) -> Skin:
    return Skin(ros)


@pytest.mark.nightly
def test_what_came_before_the_clock_is_written_once_it_is_known(skin: Skin) -> None:
    skin.send(1.0)
    skin.send(2.0, 3.0)
    assert skin.raw.values == [1.0, 2.0, 3.0]
    skin.expect()
    skin.measure()
    skin.expect(1.0, 2.0, 3.0)
    skin.bridge.clock_known()
    skin.send(4.0)
    skin.expect(1.0, 2.0, 3.0, 4.0)
    assert (skin.counters.unstamped, skin.counters.unfit) == (0, 0)
    skin.bridge.end(0)
    assert skin.counters.unstamped == 0


@pytest.mark.nightly
def test_what_comes_between_measurement_and_word_of_it_keeps_its_place(skin: Skin) -> None:
    skin.send(1.0)
    skin.clocks.correction = OFFSET_S
    skin.send(2.0)
    skin.expect()
    skin.bridge.clock_known()
    skin.send(3.0)
    skin.expect(1.0, 2.0, 3.0)


@pytest.mark.nightly
def test_a_known_clock_makes_nothing_wait(ros: Ros) -> None:
    skin = Skin(ros, OFFSET_S)
    skin.send(1.0)
    skin.send(2.0)
    skin.expect(1.0, 2.0)


@pytest.mark.nightly
def test_what_waits_does_not_change_with_the_memory_that_it_came_in(skin: Skin) -> None:
    values, stamps = np.array([[1.0], [2.0]], np.float32), np.array([1.0, 2.0])
    skin.bridge.receive(Block(values, stamps))
    values[:], stamps[:] = 0.0, 0.0
    skin.measure()
    skin.expect(1.0, 2.0)


@pytest.mark.nightly
def test_a_clock_that_stays_unknown_is_counted(skin: Skin) -> None:
    skin.send(1.0)
    skin.send(2.0, 3.0)
    skin.bridge.end(0)
    assert skin.counters.unstamped == 3
    skin.measure()
    skin.expect()
    skin.send(4.0)
    skin.expect(4.0)


@pytest.mark.nightly
def test_what_nobody_reads_does_not_wait(skin: Skin) -> None:
    skin.timed.set_readers(0)
    skin.send(1.0)
    skin.timed.set_readers(1)
    skin.send(2.0)
    skin.measure()
    skin.expect(2.0)
    assert skin.counters.unstamped == 0


@pytest.mark.nightly
def test_what_is_latched_waits_without_a_reader(ros: Ros) -> None:
    skin = Skin(ros)
    skin.timed.set_readers(0)
    skin.timed.latched = True
    skin.send(1.0)
    skin.measure()
    skin.expect(1.0)


@pytest.mark.nightly
def test_the_oldest_give_way_and_are_counted(ros: Ros, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bridge_module, "HELD_RUNS", 3)
    skin = Skin(ros)
    skin.send(1.0, 2.0)
    for stamp in (3.0, 4.0, 5.0, 6.0):
        skin.send(stamp)
    assert skin.counters.unstamped == 3
    skin.measure()
    skin.expect(4.0, 5.0, 6.0)


@pytest.mark.nightly
def test_a_silenced_stream_lets_nothing_wait(skin: Skin) -> None:
    skin.bridge.settings = StreamSettings(raw=False, chunk=False, chunk_length=4)
    skin.send(1.0)
    skin.measure()
    skin.expect()
    skin.bridge.end(0)
    assert skin.counters.unstamped == 0


@pytest.mark.nightly
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300, 3e9])
def test_a_stamp_that_is_no_time_costs_its_own_sample_only(ros: Ros, bad: float) -> None:
    skin = Skin(ros, OFFSET_S)
    skin.send(1.0, bad, 3.0)
    skin.send(4.0)
    assert len(skin.raw.messages) == 4
    skin.expect(1.0, 3.0, 4.0)
    assert skin.counters.unfit == 1
    assert len(skin.warnings) == 1


class Agent:
    """The agent's counters, whose raw message needs the time."""

    def __init__(self, ros: Ros) -> None:
        header = header_of("gateway", "counters")
        self.clocks = Clocks(ros.node, OFFSET_S)
        self.publisher = RecordedPublisher(DiagnosticArray)
        self.warnings: list[str] = []
        self.counters = NodeCounters(refusals=Refusals(self.warnings.append))
        outputs = Outputs(timed=[CountersWriter(self.publisher, self.clocks)])
        self.bridge = Bridge(header, outputs, SETTINGS, self.counters, self.clocks)

    def send(self, *texts: str) -> None:
        samples: np.ndarray[Any, Any] = np.array([[text] for text in texts], object)
        self.bridge.receive(Block(samples, np.arange(1.0, 1.0 + len(texts))))


def report(pushed: int) -> str:
    return counters_text({"zephyr-U1-ecg": Counters(pushed=pushed, lost=0, last_stamp=1.0)})


@pytest.mark.nightly
def test_the_agents_counters_have_a_stamp_of_their_own(ros: Ros) -> None:
    agent = Agent(ros)
    agent.send(report(1), report(2))
    stamps = [message.header.stamp for message in agent.publisher.messages]
    assert stamps == [message_time(agent.clocks.ros_time.to_ns(s + OFFSET_S)) for s in (1.0, 2.0)]
    assert (agent.counters.unfit, agent.warnings) == (0, [])


@pytest.mark.nightly
def test_a_report_that_no_agent_writes_costs_itself_only(ros: Ros) -> None:
    agent = Agent(ros)
    agent.send(report(1), "nonsense", report(3))
    pushed = [message.status[0].values[0].value for message in agent.publisher.messages]
    assert [float(value) for value in pushed] == [1.0, 3.0]
    assert agent.counters.unfit == 1
    assert len(agent.warnings) == 1


# What has piled up, behind a cut or in a node that stood still, reaches its subscribers whole.
TOPIC = "/biosensors/backlog/EEG"
# The publisher's queue holds the messages of half a minute, at 50 Hz those of 1500 samples.
RATE_HZ, SAMPLES = 50.0, 6000
DEADLINE_S = 90.0


def play(ros: Ros, node: RunningNode, outlet: pylsl.StreamOutlet) -> list[float]:
    """Send so much that it waits in a node that stands still, which then goes on."""
    node.send(signal.SIGSTOP)
    numbers = np.arange(SAMPLES, dtype=np.float32)
    stamps = pylsl.local_clock() - (SAMPLES - numbers.astype(np.float64)) / RATE_HZ
    outlet.push_chunk(numbers[:, np.newaxis], stamps.tolist())
    ros.spin(1.0)
    node.send(signal.SIGCONT)
    return numbers.tolist()


def counted(ros: Ros) -> int:
    """Return how many samples the node says that its subscribers did not take."""
    status = ros.status(TOPIC)
    assert status is not None
    return int(status["not_taken"])


@pytest.mark.nightly
def test_a_backlog_longer_than_the_publisher_s_queue_arrives_whole(
    ros: Ros, start_node: Callable[..., RunningNode]
) -> None:
    node = start_node()
    outlet = pylsl.StreamOutlet(
        pylsl.StreamInfo("backlog", "EEG", 1, RATE_HZ, "float32", "id of backlog")
    )
    heard: list[Any] = ros.listen(Float32MultiArray, TOPIC)
    ros.attached(TOPIC, readers=1)
    not_taken, is_whole = 0, False
    deadline_s = time.monotonic() + DEADLINE_S
    # A subscriber on a busy machine may not take all that waits for it; the node counts that,
    # and such a round says nothing.
    while not is_whole:
        assert time.monotonic() < deadline_s, f"{not_taken} samples were not taken"
        heard.clear()
        numbers = play(ros, node, outlet)
        newest = numbers[-1]
        ros.until(lambda newest=newest: bool(heard) and heard[-1].data[0] == newest, "the newest")
        ros.report()
        before, not_taken = not_taken, counted(ros)
        is_whole = [message.data[0] for message in heard] == numbers
        assert is_whole or not_taken > before


NOW_S = 100


def at(now_s: int) -> Stamping:
    """Return the stamping of a node whose ``/clock`` says so many seconds."""
    now = SimpleNamespace(nanoseconds=now_s * NS_PER_S)
    clock = SimpleNamespace(ros_time_is_active=True, now=lambda: now)
    node: Any = SimpleNamespace(get_clock=lambda: clock)
    return Stamping(RosTime(node), lambda: 0.0)


def of_run(now_s: int, *stamps: float) -> list[float]:
    return (at(now_s).of_run(np.array(stamps)) / NS_PER_S).tolist()


@pytest.mark.parametrize("begin", [0.0, 5000.0, -3.0])
def test_the_newest_of_a_run_is_of_now_and_the_others_were_before(begin: float) -> None:
    stamps = [begin + place / 4 for place in range(4)]
    assert of_run(NOW_S, *stamps) == pytest.approx([99.25, 99.5, 99.75, 100.0])


def test_one_sample_is_of_now() -> None:
    assert of_run(NOW_S, 7.0) == [NOW_S]


def test_without_a_clock_all_are_of_its_zero() -> None:
    assert of_run(0, 7.0, 8.0) == [0.0, 0.0]


def test_none_is_of_before_the_clock_began() -> None:
    assert of_run(1, 0.0, 4.5, 5.0) == [0.0, 0.5, 1.0]


def test_stamps_that_run_back_or_are_no_times_stay_within_the_simulation() -> None:
    assert of_run(NOW_S, -1e300, 1e300, 5.0) == [0.0, NOW_S, NOW_S]


# Senders that stamp with ``time.time()`` instead of LSL's clock.

NODE: Any = SimpleNamespace(get_clock=lambda: SimpleNamespace(ros_time_is_active=False))
WEEKS_S = 3e6


def seconds(stamping: Stamping, stamp: float) -> float:
    (found,) = stamping.to_ns(np.array([stamp])).tolist()
    return found * 1e-9


@pytest.mark.parametrize("correction", [0.0, 12.5, -WEEKS_S, WEEKS_S])
def test_unix_stamps_become_the_ros_times_that_they_are(correction: float) -> None:
    stamping = Stamping(RosTime(NODE), lambda: correction)
    now = time.time()
    assert stamping.are_times(np.array([now, now - 3600])).all()
    for stamp in (now, now - 0.125, now + 60, now - 3600):
        assert seconds(stamping, stamp) == pytest.approx(stamp, abs=1e-6)
    assert stamping.is_unix
    # As old as it is, and not by the clock of LSL.
    assert stamping.local(now) == pytest.approx(pylsl.local_clock(), abs=60.0)


@pytest.mark.parametrize(
    "since",
    [0.0, 5000.0, time.time() - pylsl.local_clock()],
    ids=["now", "another computer", "unix"],
)
def test_stamps_of_any_lsl_clock_are_no_unix_stamps(since: float) -> None:
    # The last one is of a program whose LSL clock counts from 1970.
    stamping = Stamping(RosTime(NODE), lambda: -since)
    stamp = pylsl.local_clock() + since
    assert stamping.are_times(np.array([stamp])).all()
    assert seconds(stamping, stamp) == pytest.approx(time.time(), abs=60.0)
    assert not stamping.is_unix


def test_what_is_no_time_stays_none() -> None:
    stamping = Stamping(RosTime(NODE), lambda: 0.0)
    far = np.array([np.nan, np.inf, -np.inf, time.time() + 1e8, 1e300])
    assert not stamping.are_times(far).any()
