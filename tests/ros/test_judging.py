"""What ``/diagnostics`` says of streams and subscribers, and when."""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import inf
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float32

from biosensor_common.naming import TopicName
from biosensor_common.refusal import Refusal, Refusals
from lsl_to_ros.live_table import (
    BUSY_PATIENCE_S,
    EXIT_BUSY,
    EXIT_MISSING,
    FIRST_SAMPLE_TIMEOUT_S,
    MOST_TIMES,
    PATIENCE_S,
    Waiting,
    summary,
    top,
    waiting_share,
)
from lsl_to_ros.parameters.node import DIAGNOSTICS_PERIOD, fault
from lsl_to_ros.reports.diagnostics import LEASE_S, StreamFacts, judge, overload
from lsl_to_ros.reports.reporter import Rhythm
from lsl_to_ros.statistics import status
from lsl_to_ros.statistics.losses import Delays, NodeCounters
from lsl_to_ros.statistics.status import (
    REPORTS,
    SHARE_WINDOW_S,
    Backlog,
    Load,
    LoadFacts,
    PublishingRate,
)
from tests.rigs.recorded_topics import RecordedPublisher

# What a stream's entry in ``/diagnostics`` says, by what is known of it.


def facts(*, has_unix_stamps: bool = False, unfit: int = 0, **told: Any) -> StreamFacts:
    """Return what is known of a stream of markers that is all right, but for what is told."""
    header = SimpleNamespace(rate=0.0, identity=SimpleNamespace(sensor="psychopy"))
    bridge: Any = SimpleNamespace(
        header=header,
        last_stamp=1.0,
        has_unix_stamps=has_unix_stamps,
        counters=NodeCounters(),
    )
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
UNIX = Refusal.UNIX_STAMPS.message()
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
    (facts(doubled_s=1.0), WARN, Refusal.MAYBE_DOUBLED.message()),
    (facts(doubled_s=LEASE_S + 1), ERROR, Refusal.DOUBLED.message()),
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
    assert told == (
        "/robot/client subscribes to it as std_msgs/msg/Int32, but it is std_msgs/msg/Float32"
    )


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
    assert misfit(offered, asked) == f"it is {expected}, as /client requests"


def test_what_dds_says_of_deadlines_is_no_misfit() -> None:
    # An endless one, which nobody has asked for.
    endless = QoSProfile(depth=10, deadline=ENDLESS, liveliness_lease_duration=ENDLESS)
    assert misfit(USUAL, endless) == ""


# What is late is waited for, and overload is told once it lasts.

# What is late on a busy computer is waited for; what is broken is missing.

ECG, HR, ACC = "/biosensors/polar_h10/ecg", "/biosensors/polar_h10/hr", "/biosensors/muse/acc"
ALL = {ECG: "", HR: "", ACC: "", "/biosensors/muse/aux": "it is switched off"}
STARTED_S, FIRST_S, ASKED_S = 100.0, 105.0, 20.0


def waiting(*, is_busy: bool = False, asked_s: float | None = ASKED_S, **came_s: float) -> Waiting:
    topics = {"ecg": ECG, "hr": HR, "acc": ACC}
    made = Waiting([each for each, reason in ALL.items() if not reason], STARTED_S, asked_s)
    made.is_busy = is_busy
    for name, at_s in came_s.items():
        made.came(topics[name], at_s)
    return made


def test_the_first_sample_may_take_longer_on_a_busy_computer() -> None:
    assert waiting().end_s == STARTED_S + FIRST_SAMPLE_TIMEOUT_S
    assert waiting(is_busy=True).end_s == STARTED_S + MOST_TIMES * FIRST_SAMPLE_TIMEOUT_S


@pytest.mark.parametrize("is_busy", [False, True])
def test_it_ends_as_asked_where_all_have_come(is_busy: bool) -> None:
    complete = waiting(is_busy=is_busy, ecg=FIRST_S, hr=110.0, acc=124.0)
    assert complete.end_s == FIRST_S + ASKED_S
    assert summary(complete, ALL) == (
        ["/biosensors/muse/aux: not expected, it is switched off"],
        0,
    )
    assert waiting(is_busy=is_busy, asked_s=None, ecg=FIRST_S).end_s == inf


def test_a_topic_that_comes_late_prolongs_the_wait_for_the_others() -> None:
    assert waiting(ecg=FIRST_S, hr=106.0).end_s == FIRST_S + ASKED_S
    assert waiting(ecg=FIRST_S, hr=124.0).end_s == 124.0 + PATIENCE_S
    assert waiting(is_busy=True, ecg=FIRST_S, hr=124.0).end_s == 124.0 + BUSY_PATIENCE_S
    # Not for ever.
    most = waiting(is_busy=True, ecg=FIRST_S, hr=FIRST_S + 2.9 * ASKED_S)
    assert most.end_s == FIRST_S + MOST_TIMES * ASKED_S


def test_what_does_not_come_is_missing_where_nothing_keeps_the_computer_busy() -> None:
    lines, code = summary(waiting(ecg=FIRST_S, hr=106.0), ALL)
    assert code == EXIT_MISSING
    assert f"{ACC}: MISSING" in lines
    assert not any("too busy" in line for line in lines)


def test_what_does_not_come_on_a_busy_computer_is_late() -> None:
    lines, code = summary(waiting(is_busy=True, ecg=120.0), ALL)
    assert code == EXIT_BUSY
    assert lines[-1] == "this computer is too busy: 2 topics have not arrived yet"
    assert not any("MISSING" in line for line in lines)
    lines, _ = summary(waiting(is_busy=True, ecg=120.0, hr=121.0), ALL)
    assert lines[-1] == "this computer is too busy: 1 topic has not arrived yet"
    # Nor is it missing where nothing has come at all.
    lines, code = summary(waiting(is_busy=True), ALL)
    assert (code, lines[-1]) == (
        EXIT_BUSY,
        "this computer is too busy: 3 topics have not arrived yet",
    )


def test_who_ends_it_early_is_told_what_has_not_come() -> None:
    stopped = waiting(is_busy=True, ecg=120.0)
    stopped.is_cut_short = True
    lines, code = summary(stopped, ALL)
    assert code == EXIT_MISSING
    assert lines[-2:] == [f"{HR}: not yet", f"{ACC}: not yet"]


def test_without_an_end_nothing_is_a_failure() -> None:
    lines, code = summary(waiting(asked_s=None, ecg=FIRST_S), ALL)
    assert code == 0
    assert f"{HR}: MISSING" in lines


def test_the_share_of_waiting_is_that_of_all_threads() -> None:
    assert waiting_share(["1000 3000 5", "1000 1000 2"]) == pytest.approx(4 / 6)
    assert waiting_share([]) is None
    assert waiting_share(["0 0 0"]) is None


# Overload is told once it lasts, and is over once it is clearly less.
WINDOW = round(SHARE_WINDOW_S)


class Process:
    """A node whose time and work are the test's."""

    def __init__(self) -> None:
        self.now_s, self.used_s = 100.0, 7.0
        self.load = Load(lambda: self.now_s, lambda: self.used_s)
        self.load.look()

    def live(self, *shares: float, ages: Sequence[float] = (0.0,)) -> LoadFacts:
        """Live a second at each share of a core, in which data waited so long."""
        return [self._second(share, ages) for share in shares][-1]

    def _second(self, share: float, ages: Sequence[float]) -> LoadFacts:
        self.now_s += 1.0
        self.used_s += share
        for age_s in ages:
            self.load.waited(age_s)
        return self.load.look()


def test_a_short_strain_is_no_overload() -> None:
    node = Process()
    facts = node.live(*[1.3] * 6, *[0.1] * 4)
    assert facts.share == pytest.approx(0.82)
    node = Process()
    facts = node.live(*[1.3] * 5, *[0.1] * 5)
    assert facts.share == pytest.approx(0.7)
    assert overload(facts) == ""


def test_nothing_is_said_of_the_first_seconds() -> None:
    facts = Process().live(*[1.9] * (WINDOW - 1))
    assert facts.share is None
    assert overload(facts) == ""


def test_a_lasting_strain_says_how_much_and_what_to_do() -> None:
    facts = Process().live(*[0.92] * WINDOW, ages=[0.02, 0.31, 0.1])
    said = overload(facts)
    assert "92 % of a core" in said
    assert "0.3 s" in said
    for remedy in ("_chunk", "_stamped", "Sensor_Enable", "stream_predicate"):
        assert remedy in said


def test_what_sways_about_a_limit_is_told_once() -> None:
    node = Process()
    node.live(*[0.9] * WINDOW)
    judged = [node.live(*[share] * WINDOW).is_busy for share in (0.7, 0.82, 0.66, 0.78, 0.6, 0.78)]
    assert judged == [True, True, True, True, False, False]


def test_data_that_wait_only_now_and_then_are_no_overload() -> None:
    node = Process()
    for _ in range(4):
        assert not node.live(*[0.2] * (REPORTS - 1), ages=[3.0]).is_late
        assert not node.live(0.2, ages=[0.1]).is_late


def test_data_that_wait_all_the_time_are_told_until_they_clearly_do_not() -> None:
    node = Process()
    facts = node.live(*[0.2] * WINDOW, ages=[1.4])
    assert (facts.is_late, facts.is_busy) == (True, False)
    said = overload(facts)
    assert "1.4 s" in said
    assert "20 % of a core" in said
    assert "other programs" in said
    assert node.live(*[0.2] * 10, ages=[0.6]).is_late
    assert node.live(*[0.2] * (REPORTS - 1), ages=[0.1]).is_late
    assert not node.live(0.2, ages=[0.1]).is_late


def test_the_oldest_of_what_waits_has_waited_since_it_came() -> None:
    backlog = Backlog()
    assert backlog.age(0.0, 10, 0) == 0.0
    assert backlog.age(1.0, 10, 5) == 0.0
    assert backlog.age(2.0, 10, 9) == 1.0
    # Those of the second look are the oldest now, and then those of the third.
    assert backlog.age(3.0, 16, 8) == 1.0
    assert backlog.age(4.0, 20, 9) == 1.0
    assert backlog.age(5.0, 29, 0) == 0.0
    assert backlog.age(6.0, 29, 1) == 0.0


def test_a_look_in_the_midst_of_a_pull_makes_nothing_older() -> None:
    backlog = Backlog()
    backlog.age(0.0, 0, 100)
    # They have left liblsl and are not counted yet.
    assert backlog.age(1.0, 0, 0) == 0.0
    assert backlog.age(2.0, 100, 30) == 0.0


def test_a_topic_is_too_fast_until_it_is_clearly_slower(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, published = 0.0, 0
    monkeypatch.setattr(status, "monotonic", lambda: now_s)
    flow = PublishingRate()
    judged: list[bool] = []
    for rate in (3900, 4100, 3100, 2900, 3900):
        for _ in range(11):
            now_s += 1.0
            published += rate
            assert flow.look(published, 0) == 0
        judged.append(flow.is_fast)
        assert flow.rate == rate
    assert judged == [False, True, True, False, False]
    # The stream has moved to another topic, which has published nothing yet.
    assert flow.look(0, 0) == 0
    assert flow.rate == 0.0


def test_what_was_not_taken_is_told_for_10_s(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 0.0
    monkeypatch.setattr(status, "monotonic", lambda: now_s)
    flow = PublishingRate()
    grown: list[int] = []
    for second in range(15):
        now_s = float(second)
        grown.append(flow.look(100, 50 if second >= 2 else 0))
    assert grown == [0, 0, *[50] * 10, 0, 0, 0]


@pytest.mark.parametrize(("height", "kept"), [(0, 9), (10, 9), (9, 7), (24, 9), (2, 1)])
def test_a_low_terminal_shows_the_headings_and_says_what_it_leaves_out(
    height: int, kept: int
) -> None:
    lines = ["topic  type", *(f"/biosensors/{each}  Float32" for each in range(8))]
    shown = top("\n".join(lines), height).splitlines()
    assert shown[:kept] == lines[:kept]
    left_out = [f"... and {9 - kept} more topics: in a higher window, or at the end"]
    assert shown[kept:] == (left_out if kept < 9 else [])
