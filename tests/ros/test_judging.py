"""What ``/diagnostics`` says of streams and subscribers, and when."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float32

from biosensor_common.naming import TopicName
from biosensor_common.refusal import Refusal, Refusals
from lsl_to_ros.parameters.node import DIAGNOSTICS_PERIOD, fault
from lsl_to_ros.reports.diagnostics import LEASE_S, StreamFacts, judge
from lsl_to_ros.reports.reporter import Rhythm
from lsl_to_ros.statistics.losses import Delays
from tests.rigs.recorded_topics import RecordedPublisher

# What a stream's entry in ``/diagnostics`` says, by what is known of it.


def facts(*, has_unix_stamps: bool = False, unfit: int = 0, **told: Any) -> StreamFacts:
    """Return what is known of a stream of markers that is all right, but for what is told."""
    header = SimpleNamespace(rate=0.0, identity=SimpleNamespace(sensor="psychopy"))
    bridge: Any = SimpleNamespace(header=header, last_stamp=1.0, has_unix_stamps=has_unix_stamps)
    refusals = Refusals()
    if unfit:
        refusals.refuse(Refusal.UNFIT, unfit, why="it is too large")
    usual: dict[str, Any] = {
        **dict.fromkeys(("age_s", "rate", "correction_s", "spread_s", "silent_s"), 0.0),
        **dict.fromkeys(("attached_s", "published_hz", "waited_s"), 0.0),
        **dict.fromkeys(("lost_lately", "not_taken_lately"), 0),
        "delays": Delays(),
        "is_fast": False,
        "refused": refusals.present,
        "topic": TopicName("psychopy", "Markers"),
    }
    bridge.outputs = SimpleNamespace(chunk=None, timed=[])
    return StreamFacts(bridge=bridge, **(usual | told))


OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
UNIX = Refusal.UNIX_STAMPS.told()
SHARED, CLAIMED = (
    TopicName("psychopy", "Markers", conflict=True),
    TopicName("psychopy", "Markers", duplicate=True),
)
DELAYED = Delays(total=4000.0, count=1, longest=4000.0)
JUDGED: list[tuple[StreamFacts, bytes, str]] = [
    (facts(), OK, "streaming"),
    (facts(topic=SHARED), ERROR, "two units of one sensor: give each a label"),
    (facts(topic=CLAIMED), ERROR, "two streams claim to be this one"),
    (facts(twins=["lab-pc"]), ERROR, "that on lab-pc is not published: give each sender"),
    (facts(senders=["a", "b"]), WARN, "2 senders have the same source_id, name and type, on a, b"),
    (facts(doubled_s=1.0), WARN, Refusal.MAYBE_DOUBLED.told()),
    (facts(doubled_s=LEASE_S + 1), ERROR, Refusal.DOUBLED.told()),
    (facts(delays=DELAYED), WARN, "its timestamps are not times of the LSL clock"),
    (facts(correction_s=None, attached_s=60.0), WARN, "the sender's clock cannot be queried"),
    (facts(unfit=3), WARN, "3 samples were not published: it is too large"),
    # None hides another one.
    (facts(has_unix_stamps=True, unfit=1), WARN, f"{UNIX}; 1 sample was not published"),
]


@pytest.mark.parametrize(("told", "level", "words"), JUDGED)
def test_what_is_doubled_or_left_out_is_no_good_stream(
    told: StreamFacts, level: bytes, words: str
) -> None:
    judged, reason = judge(told)
    assert judged == level
    assert words in reason


# Which looks at the node are published on ``/diagnostics``.
WELL, WARNED = DiagnosticStatus.OK, DiagnosticStatus.WARN


def statuses(*levels: bytes) -> list[DiagnosticStatus]:
    return [DiagnosticStatus(name=f"{at}", level=level) for at, level in enumerate(levels)]


@pytest.mark.parametrize(("period_s", "every"), [(1.0, 1), (1.4, 1), (3.0, 3), (10.0, 10)])
def test_each_so_many_looks_one_is_published(period_s: float, every: int) -> None:
    rhythm = Rhythm(lambda: period_s)
    due = [rhythm.is_due(statuses(WELL)) for _ in range(30)]
    # The first entry is news.
    assert [at for at, is_due in enumerate(due) if is_due] == list(range(0, 30, every))


@pytest.mark.parametrize("worse", [(WARNED, WELL), (WELL, WELL, WELL), (WELL,)])
def test_news_do_not_wait(worse: tuple[bytes, ...]) -> None:
    rhythm = Rhythm(lambda: 100.0)
    looks = [(WELL, WELL), (WELL, WELL), worse, worse, (WELL, WELL)]
    due = [rhythm.is_due(statuses(*levels)) for levels in looks]
    assert due == [True, False, True, False, True]


@pytest.mark.parametrize("value", [0.0, 0.9, -1.0, 3601.0, math.nan, math.inf])
def test_other_periods_are_refused(value: float) -> None:
    assert "must be from 1 to 3600 seconds" in (fault(DIAGNOSTICS_PERIOD, value) or "")
    assert fault(DIAGNOSTICS_PERIOD, 1) is None


# Subscribers that get nothing of a topic, as DDS tells of them.
USUAL = QoSProfile(depth=10)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
ENDLESS = Duration(seconds=9223372036, nanoseconds=854775807)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def misfit(
    offered: QoSProfile, asked: QoSProfile, kind: str = "std_msgs/msg/Float32", where: str = "/"
) -> str:
    topic = RecordedPublisher(Float32)
    publisher: Any = topic.ros_publisher
    publisher.qos_profile = offered
    reader: Any = SimpleNamespace(
        node_name="client", node_namespace=where, topic_type=kind, qos_profile=asked
    )
    return topic.misfit(reader)


@pytest.mark.parametrize(
    ("offered", "asked"), [(USUAL, USUAL), (USUAL, BEST_EFFORT), (LATCHED, USUAL)]
)
def test_who_asks_for_no_more_than_there_is_fits(offered: QoSProfile, asked: QoSProfile) -> None:
    assert misfit(offered, asked) == ""


def test_another_type_is_named() -> None:
    told = misfit(USUAL, USUAL, "std_msgs/msg/Int32", "/robot")
    assert told == "/robot/client reads it as std_msgs/msg/Int32, and it is std_msgs/msg/Float32"


@pytest.mark.parametrize(
    ("offered", "asked", "expected"),
    [
        (USUAL, LATCHED, "volatile and not transient_local"),
        (BEST_EFFORT, USUAL, "best_effort and not reliable"),
        (
            BEST_EFFORT,
            LATCHED,
            "best_effort and not reliable and volatile and not transient_local",
        ),
    ],
)
def test_what_is_asked_for_and_not_offered_is_named(
    offered: QoSProfile, asked: QoSProfile, expected: str
) -> None:
    assert misfit(offered, asked) == f"it is {expected}, as /client wants it"


def test_what_dds_says_of_deadlines_is_no_misfit() -> None:
    # An endless one, which nobody has asked for.
    endless = QoSProfile(depth=10, deadline=ENDLESS, liveliness_lease_duration=ENDLESS)
    assert misfit(USUAL, endless) == ""
