"""The node ``ros_to_lsl``, which finds topics and sends them as streams."""

from __future__ import annotations

import json
import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from difflib import get_close_matches
from functools import partial
from time import monotonic, time_ns
from typing import Any

import pylsl
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_msgs.msg import Header

from biosensor_common.clocks import MonotonicStamps
from biosensor_common.lsl.api_file import LslOverrides
from biosensor_common.lsl.network import configure_lsl
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.ros_clock import NS_PER_S, measure_clock_pair
from lsl_to_ros import program
from lsl_to_ros.limited_log import LimitedLog
from lsl_to_ros.parameters.node import DIAGNOSTICS_PERIOD, KNOWN_PEERS, SESSION_ID, peers_of
from lsl_to_ros.reports.clock_pairs import events_outlet
from lsl_to_ros.reports.diagnostics import named_by
from lsl_to_ros.reports.reporter import Rhythm
from lsl_to_ros.ros_to_lsl.graph import Graph, Topic, are_named
from lsl_to_ros.ros_to_lsl.parameters import TopicRequest, read_requests, stream_name
from lsl_to_ros.ros_to_lsl.reports import (
    PROGRAM,
    node_status,
    topic_facts,
    topic_status,
)
from lsl_to_ros.ros_to_lsl.stamps import Offset
from lsl_to_ros.ros_to_lsl.topic_bridge import Bridge
from lsl_to_ros.ros_to_lsl.topic_outlets import OtherOutlet, OtherOutlets
from lsl_to_ros.statistics.ros_time import RosTime
from lsl_to_ros.subscriber_thread import TakenElsewhere, Taker
from lsl_to_ros.topics.publishers import make_publisher

LOOK_PERIOD_S = 0.25
LOOKS_BETWEEN = 4
"""The publishers of a topic that has some are queried once in so many rounds, which saves time."""
LOOKS_TO_MEET = 4
"""Rounds in which the publishers of a requested topic are seen before it is subscribed."""
LOOKS_TO_SETTLE = 8
"""Rounds after which the node of a topic's publisher is known."""
# By then the node has discovered the others.
FOUND_AFTER_S = 5.0
REPORT_PERIOD_S = 1.0
HEARTBEAT_S = 5.0
OFFSET_ANSWERS = 5
"""Number of answers in one measurement."""
OFFSET_EVERY_S = 30.0
"""Pause between two measurements."""
OFFSET_GIVE_UP_S = 5.0
"""Time limit for an answer; a node without it may not have the service."""
_ASKED_FOR = "use_sim_time"


class RosToLsl(Node):
    """Sends topics as LSL streams; see the project's docs/ros-to-lsl.md.

    Raises
    ------
    ConfigError
        If a parameter is wrong.
    """

    def __init__(self) -> None:
        super().__init__(
            PROGRAM,
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
        )
        self._requests = read_requests(self, self.resolve_topic_name)
        value = self.get_parameter
        peers = peers_of(value(KNOWN_PEERS).value)
        configure_lsl(LslOverrides(value(SESSION_ID).value, peers))
        self._log = LimitedLog(self.get_logger())
        self._refusals = Refusals(self._log.warn)
        self._ros_time = RosTime(self)
        self._topics: dict[str, Topic] = {}
        self._events = Events(self, self._facts)
        self._taker = Taker(self, self._fail)
        self._group = TakenElsewhere()
        self._seen: dict[str, int] = {}
        self._left_out: list[str] = []
        self._met: Counter[str] = Counter()
        self._looks = 0
        self._offsets = SenderOffsets(self)
        self._other_outlets = OtherOutlets()
        self._missed_s = monotonic() + FOUND_AFTER_S
        for request in self._requests.topics:
            self._open(request)
        self._diagnostics = make_publisher(self, "/diagnostics", DiagnosticArray)
        self._rhythm = Rhythm(lambda: value(DIAGNOSTICS_PERIOD).value)
        # With the node's own clock the timers would stop for as long as that is set back.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(LOOK_PERIOD_S, self._look, clock=steady)
        self.create_timer(REPORT_PERIOD_S, self._report, clock=steady)
        self._look()

    def stop(self) -> None:
        """Send the messages received so far, and stop."""
        self._taker.stop()
        for each in self._topics.values():
            each.bridge.end()

    def _open(self, request: TopicRequest) -> None:
        say = partial(self._say, request.topic)
        bridge = Bridge(request, self._ros_time, say, by_arrival=self._requests.by_arrival)
        topic = Topic(self, self._taker, self._group, bridge, say)
        self._topics[request.topic] = topic

    def _look(self) -> None:
        """Update the publishers of all topics, and do scheduled work."""
        graph = Graph(self)
        if self._requests.all_small:
            self._open_small(graph)
        self._looks += 1
        is_to_ask_all = self._looks % LOOKS_BETWEEN == 0
        others = self._other_outlets.look() if is_to_ask_all else []
        for each in self._topics.values():
            if is_to_ask_all or each.kind is None:
                self._follow(graph, each)
            if is_to_ask_all:
                self._tell_sent_twice(each, others)
        now = pylsl.local_clock()
        for each in self._topics.values():
            each.bridge.look(now)
        self._offsets.look(self._topics.values())
        self._events.look(now)

    def _open_small(self, graph: Graph) -> None:
        """Open small topics once they were seen long enough to know their publisher's node."""
        self._left_out = sorted(set(graph.left_out()) - self._topics.keys())
        topics = ", ".join(self._left_out)
        self._refusals.hold(Refusal.NOT_SMALL, bool(topics), topics=topics)
        self._seen = {name: self._seen.get(name, 0) + 1 for name in graph.small()}
        for name in sorted(self._seen.keys() - self._topics.keys()):
            if self._seen[name] <= LOOKS_TO_SETTLE:
                # nothing is dropped: it is not subscribed yet
                continue
            publishers = graph.publishers(name)
            if publishers and are_named(publishers) and not graph.is_ours(publishers):
                self._open(TopicRequest(name, stream_name(name)))

    def _follow(self, graph: Graph, topic: Topic) -> None:
        publishers = graph.publishers(topic.name)
        self._tell_absent(graph, topic, is_absent=not publishers)
        if topic.kind is None and publishers and not self._is_met(graph, topic.name, publishers):
            # nothing is dropped: it is not subscribed yet
            return
        if graph.is_ours(publishers):
            topic.refuse("lsl_to_ros publishes it, so it is already an LSL stream")
            return
        was_known = topic.kind is not None
        lost = topic.follow(publishers)
        if lost:
            topic.bridge.refusals.refuse(Refusal.LOST_ON_THE_WAY, lost)
        if topic.kind is not None and not was_known and not topic.bridge.fault:
            # nothing is dropped: it begins
            self._log.inform(f"{topic.name} ({topic.kind.name}): {topic.quality}")

    def _tell_sent_twice(self, topic: Topic, others: Collection[OtherOutlet]) -> None:
        """Report that another node of this program sends a topic, or a stream of its name.

        Parameters
        ----------
        others
            The outlets of other processes, by which a node with another name, or of another
            robot, is known.
        """
        readers = self.get_subscriptions_info_by_topic(topic.name)
        of_program = sum(each.node_name in {PROGRAM, self.get_name()} for each in readers)
        is_read_twice = of_program > topic.is_subscribed and not topic.bridge.fault
        own, hold = topic.bridge.source_ids, topic.bridge.refusals.hold
        hold(Refusal.SENT_TWICE, is_read_twice or any(each.source_id in own for each in others))
        alike = [e for e in others if e.name in topic.bridge.streams and e.source_id not in own]
        hosts, names = (
            ", ".join(sorted(set(all_)))
            for all_ in ([e.host for e in alike], [e.name for e in alike])
        )
        hold(Refusal.SAME_NAME, bool(alike), hosts=hosts, names=names)

    def _is_met(self, graph: Graph, topic: str, publishers: Sequence[TopicEndpointInfo]) -> bool:
        """Whether a topic's publishers were seen long enough to know their nodes."""
        self._met[topic] += 1
        # Publishers that are not ROS nodes never get a node name.
        needed = LOOKS_TO_MEET if are_named(publishers) else LOOKS_TO_SETTLE
        return self._met[topic] > needed

    def _tell_absent(self, graph: Graph, topic: Topic, *, is_absent: bool) -> None:
        """Report a topic that nobody publishes: its name may be misspelt, or its node has ended.

        Events may be published by programs that end after each of them.
        """
        bridge = topic.bridge
        is_missed = is_absent and (bridge.sends_numbers or not bridge.received)
        hint = ""
        if is_missed and not bridge.received:
            published = [name for name in graph.topics if name not in self._topics]
            similar = get_close_matches(topic.name, published, n=1)
            hint = f"; is {similar[0]} meant?" if similar else ""
            if topic.name in dict(self.get_service_names_and_types()):
                hint = "; it is a service, and only topics are sent"
        since = "any more" if bridge.received else "yet"
        is_told = is_missed and not bridge.fault and monotonic() > self._missed_s
        bridge.refusals.hold(Refusal.NO_PUBLISHER, is_told, since=since, hint=hint)

    def _say(self, topic: str, sentence: str) -> None:
        # nothing is dropped: this is where refusals are said
        self._log.warn(f"{topic}: {sentence}")
        self._events.notice(topic, sentence)

    def _fail(self, subscription: Subscription, error: Exception) -> None:
        # Every message may fail, so this is not an event; the log repeats it once a minute.
        topic = subscription.topic_name
        self._refusals.refuse(Refusal.SEND_FAILED, about=topic, why=repr(error))

    def _facts(self) -> dict[str, Any]:
        return {name: topic_facts(each) for name, each in list(self._topics.items())}

    def _report(self) -> None:
        jump_ns = self._ros_time.refresh()
        if jump_ns is not None:
            self._offsets.restart()
            # nothing is dropped: clocks are judged again
            self._log.warn(
                f"the system clock jumped by {jump_ns / 1e9:.6f} s; timestamps follow it"
            )
            for each in self._topics.values():
                each.bridge.clock_was_set()
        streams = sum(len(each.bridge.streams) for each in self._topics.values())
        statuses = [
            node_status(
                len(self._topics), streams, self._ros_time.steps, self._left_out, self._refusals
            )
        ]
        statuses += [topic_status(each) for each in self._topics.values()]
        named_by(self, statuses)
        if not self._rhythm.is_due(statuses):
            # nothing is dropped: they are as they were
            return
        header = Header(stamp=self.get_clock().now().to_msg())
        self._diagnostics.publish(DiagnosticArray(header=header, status=statuses))


def run() -> None:
    """Run the node until SIGINT or SIGTERM; exit code 0, or 2 for unusable settings."""
    program.run(PROGRAM, _node)


def _node(_stopping: threading.Event) -> tuple[Node, Callable[[], None]]:
    node = RosToLsl()
    return node, node.stop


class Events:
    """Sends events; thread-safe.

    Parameters
    ----------
    node
        Its name and domain distinguish the nodes of one computer.
    topics
        Returns facts about every topic, for the heartbeat.
    """

    def __init__(self, node: Node, topics: Callable[[], Mapping[str, object]]) -> None:
        self._topics = topics
        self._lock = threading.Lock()
        self._stamps = MonotonicStamps()
        self._due_s, self._had_consumers = -math.inf, False
        self._outlet = events_outlet(node, "ros_to_lsl")
        self._send("started", _clock_facts())

    def notice(self, topic: str, text: str) -> None:
        """Send a log sentence about a topic as an event."""
        self._send("notice", {"topic": topic, "text": text})

    def look(self, now: float) -> None:
        """Send a heartbeat if one is scheduled; call it a few times a second with the LSL time."""
        has_consumers = self._outlet.have_consumers()
        has_come, self._had_consumers = has_consumers and not self._had_consumers, has_consumers
        if has_come or now >= self._due_s:
            self._due_s = now + HEARTBEAT_S
            self._send("heartbeat", {"topics": dict(self._topics()), **_clock_facts()})

    def _send(self, event: str, facts: Mapping[str, object]) -> None:
        with self._lock:
            now = pylsl.local_clock()
            content = {"event": event, **facts, "lsl_time": round(now, 6)}
            (stamp,) = self._stamps.apply([now])
            self._outlet.push_sample([json.dumps(content, separators=(",", ":"))], stamp)


def _clock_facts() -> dict[str, object]:
    return measure_clock_pair(time.time_ns, pylsl.local_clock).as_facts()


class Bounds:
    """Bounds of a clock offset from the answers of one measurement."""

    def __init__(self) -> None:
        self.answers = 0
        self._least_ns, self._most_ns = -math.inf, math.inf

    def take(self, asked_ns: int, sent_ns: int, received_ns: int) -> None:
        """Add the times of a request and its answer, by its sender's clock and by ours."""
        if not sent_ns or not received_ns:
            return  # nothing is dropped: it only tells a time
        self.answers += 1
        self._least_ns = max(self._least_ns, sent_ns - received_ns)
        self._most_ns = min(self._most_ns, sent_ns - asked_ns)

    @property
    def offset(self) -> Offset | None:
        """Return the clock's offset; None without answers, or if a clock was set in between."""
        if not self.answers or self._least_ns > self._most_ns:
            return None
        return Offset(self._least_ns / NS_PER_S, self._most_ns / NS_PER_S)


class SenderOffsets:
    """Measures the clocks of nodes for as long as a topic needs them."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._asked: dict[str, SenderOffset] = {}

    def look(self, topics: Iterable[Topic]) -> None:
        """Do scheduled work; call it a few times a second."""
        wanted: dict[str, list[Topic]] = {}
        for each in topics:
            if each.sender and each.wants_offset:
                wanted.setdefault(each.sender, []).append(each)
        for name in self._asked.keys() - wanted.keys():
            self._asked.pop(name).stop()
        for name, those in wanted.items():
            if name not in self._asked:
                self._asked[name] = SenderOffset(self._node, name)
            offset = self._asked[name].look()
            if offset is not None:
                for each in those:
                    each.bridge.take_offset(offset)

    def restart(self) -> None:
        """Abort measurements, because this computer's clock was set."""
        for each in self._asked.values():
            each.stop()
        self._asked.clear()


class SenderOffset:
    """Measures one node's clock repeatedly; :meth:`look` never blocks."""

    def __init__(self, node: Node, name: str) -> None:
        self._node = node
        self._client = node.create_client(
            GetParameters, f"{name}/get_parameters", callback_group=TakenElsewhere()
        )
        # rclpy's client discards the timestamps of an answer.
        self._handle = self._client.handle
        self._bounds = Bounds()
        self._asked_ns, self._asked_s, self._due_s, self._number = 0, 0.0, 0.0, 0

    def look(self) -> Offset | None:
        """Send a request or take an answer; return the offset once it is measured."""
        now_s = monotonic()
        if self._asked_ns:
            self._take(now_s)
        if self._bounds.answers >= OFFSET_ANSWERS:
            offset = self._bounds.offset
            self._bounds, self._due_s = Bounds(), now_s + OFFSET_EVERY_S
            return offset
        if not self._asked_ns and now_s >= self._due_s and self._client.service_is_ready():
            self._asked_ns, self._asked_s = time_ns(), now_s
            self._number = self._handle.send_request(GetParameters.Request(names=[_ASKED_FOR]))
        return None  # nothing is dropped: there is no offset yet

    def stop(self) -> None:
        """Stop measuring."""
        self._node.destroy_client(self._client)

    def _take(self, now_s: float) -> None:
        told, answer = self._handle.take_response(GetParameters.Response)
        # The answer to an aborted request may still come.
        if answer is not None and told.request_id.sequence_number == self._number:
            self._bounds.take(self._asked_ns, told.source_timestamp, told.received_timestamp)
            self._asked_ns = 0
        elif now_s - self._asked_s > OFFSET_GIVE_UP_S:
            self._asked_ns, self._due_s = 0, now_s + OFFSET_EVERY_S
            self._bounds = Bounds()
