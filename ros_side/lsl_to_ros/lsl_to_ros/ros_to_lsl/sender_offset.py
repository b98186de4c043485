"""Measures the clock of a node that publishes, by what it answers.

Every node of ROS has services for its parameters. DDS stamps the answer when it is sent, by the
answering computer's clock; by this computer's clock that was after the request and before the
arrival of the answer. Each answer so bounds the offset from both sides, and several bound it
more closely: to a millisecond over a good network.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from time import monotonic, time_ns
from typing import Protocol

from rcl_interfaces.srv import GetParameters
from rclpy.node import Node

from biosensor_common.ros_clock import NS_PER_S
from lsl_to_ros.ros_to_lsl.publisher_clock import Offset
from lsl_to_ros.ros_to_lsl.topic import Topic
from lsl_to_ros.taking import TakenElsewhere

ANSWERS = 5
"""So many make a measurement."""
PERIOD_S = 30.0
"""Between the end of a measurement and the begin of the next."""
GIVE_UP_S = 5.0
"""A node that has not answered for so long does not answer: it may have no such service."""
_ASKED = "use_sim_time"


class Answer(Protocol):
    """What ROS tells of an answer, in nanoseconds since 1970."""

    @property
    def source_timestamp(self) -> int:
        """When it was sent, by the clock of who did it."""
        ...

    @property
    def received_timestamp(self) -> int:
        """When it came, by this computer's clock."""
        ...


class Bounds:
    """What the answers of one measurement say together."""

    def __init__(self) -> None:
        self.answers = 0
        self._least_ns, self._most_ns = -math.inf, math.inf

    def take(self, asked_ns: int, answer: Answer) -> None:
        """Take in an answer, and when it was asked for."""
        if not answer.source_timestamp or not answer.received_timestamp:
            return
        self.answers += 1
        self._least_ns = max(self._least_ns, answer.source_timestamp - answer.received_timestamp)
        self._most_ns = min(self._most_ns, answer.source_timestamp - asked_ns)

    @property
    def offset(self) -> Offset | None:
        """The clock's offset; None before an answer, or if a clock was set in between."""
        if not self.answers or self._least_ns > self._most_ns:
            return None
        return Offset(self._least_ns / NS_PER_S, self._most_ns / NS_PER_S)


class SenderOffsets:
    """Measures the clocks of nodes, as long as somebody wants to know them."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._asked: dict[str, SenderOffset] = {}

    def look(self, topics: Iterable[Topic]) -> None:
        """Do what is due; a few times a second."""
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
        """Give up what is being measured, since this computer's own clock was set."""
        for each in self._asked.values():
            each.stop()
        self._asked.clear()


class SenderOffset:
    """Asks one node, again and again; :meth:`look` never waits."""

    def __init__(self, node: Node, name: str) -> None:
        self._node = node
        self._client = node.create_client(
            GetParameters, f"{name}/get_parameters", callback_group=TakenElsewhere()
        )
        # rclpy's client throws away what it is told of an answer.
        self._handle = self._client.handle
        self._bounds = Bounds()
        self._asked_ns, self._asked_s, self._due_s, self._number = 0, 0.0, 0.0, 0

    def look(self) -> Offset | None:
        """Ask, or take the answer; return the offset when it has been measured."""
        now_s = monotonic()
        if self._asked_ns:
            self._take(now_s)
        if self._bounds.answers >= ANSWERS:
            offset = self._bounds.offset
            self._bounds, self._due_s = Bounds(), now_s + PERIOD_S
            return offset
        if not self._asked_ns and now_s >= self._due_s and self._client.service_is_ready():
            self._asked_ns, self._asked_s = time_ns(), now_s
            self._number = self._handle.send_request(GetParameters.Request(names=[_ASKED]))
        return None

    def stop(self) -> None:
        """Ask nothing more."""
        self._node.destroy_client(self._client)

    def _take(self, now_s: float) -> None:
        told, answer = self._handle.take_response(GetParameters.Response)
        # One that was given up may still come.
        if answer is not None and told.request_id.sequence_number == self._number:
            self._bounds.take(self._asked_ns, told)
            self._asked_ns = 0
        elif now_s - self._asked_s > GIVE_UP_S:
            self._asked_ns, self._due_s = 0, now_s + PERIOD_S
            self._bounds = Bounds()
