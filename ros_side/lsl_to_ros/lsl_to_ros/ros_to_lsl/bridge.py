"""Sends the messages of one topic."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import time_ns
from typing import Any

from biosensor_common.errors import GatewayError
from lsl_to_ros.accounts.ros_time import RosTime
from lsl_to_ros.ros_to_lsl.fields import FRAMES, HEADER, has_header
from lsl_to_ros.ros_to_lsl.losses import PublicationLosses
from lsl_to_ros.ros_to_lsl.outlets import MarkerOutlet, Origin, with_stamp
from lsl_to_ros.ros_to_lsl.publisher_clock import ClockState
from lsl_to_ros.ros_to_lsl.requests import SendAs, TopicRequest
from lsl_to_ros.ros_to_lsl.senders import NumberSender, Sender, senders_for
from lsl_to_ros.ros_to_lsl.stamping import MessageStamping, StampSource
from lsl_to_ros.taking import MessageInfo, RosMessage

MAX_HELD = 5000
"""So many messages wait while it is in doubt whether a clock is right."""
OLD_MESSAGES_S = 1.0
"""What a latched topic sends to a new subscriber comes within that, and may be of any age."""


@dataclass(frozen=True, slots=True)
class MessageType:
    """The type of a topic's messages."""

    name: str
    hash: str
    message_class: type[Any]


class Bridge:
    """The way of one topic's messages into its streams; any thread may call it.

    Parameters
    ----------
    say
        Called with what a person should know of the topic.

    Attributes
    ----------
    received
        Messages.
    newest_s
        LSL time of the newest one, 0 before the first.
    fault
        Why nothing is sent; empty if something is.
    """

    def __init__(
        self,
        request: TopicRequest,
        ros_time: RosTime,
        say: Callable[[str], None],
        *,
        by_arrival: bool,
    ) -> None:
        self.request = request
        self.received, self.newest_s, self.fault = 0, 0.0, ""
        self.losses = PublicationLosses()
        self.stamping = MessageStamping(ros_time, has_header=False, by_arrival=by_arrival)
        self._ros_time, self._by_arrival = ros_time, by_arrival
        self._say = say
        self._lock = threading.Lock()
        self._origin = Origin(request.topic, request.type_name, stamp_source=self.stamping.expected)
        self._senders: list[Sender] = []
        self._markers: MarkerOutlet | None = None
        self._held: deque[tuple[RosMessage, MessageInfo]] = deque()
        self._said_wrong: set[StampSource] = set()
        if request.send_as in (SendAs.MARKERS, SendAs.JSON):
            # Before anybody publishes: a recorder must see it before the first event.
            try:
                self._marker_outlet()
            except GatewayError as error:
                self._fail(error)

    @property
    def streams(self) -> Mapping[str, int]:
        """Samples or markers that were pushed, by stream."""
        return {each.name: each.outlet.pushed for each in self._senders if each.outlet is not None}

    @property
    def is_received(self) -> bool:
        """Whether anybody receives any of the streams."""
        outlets = [each.outlet for each in self._senders]
        return any(outlet.have_consumers() for outlet in outlets if outlet is not None)

    @property
    def replaced(self) -> int:
        """How often an outlet made way for one with other channels."""
        senders = (each for each in self._senders if isinstance(each, NumberSender))
        return sum(each.replaced for each in senders)

    def connect(self, kind: MessageType) -> None:
        """Take note of the type of the messages that will come."""
        with self._lock:
            headed = has_header(kind.message_class)
            self.stamping = MessageStamping(
                self._ros_time, has_header=headed, by_arrival=self._by_arrival
            )
            self._origin = Origin(
                self.request.topic, kind.name, kind.hash, stamp_source=self.stamping.expected
            )
            try:
                self._senders = senders_for(
                    kind.message_class, self.request, self._marker_outlet, self._say
                )
            except GatewayError as error:
                self._fail(error)

    def take(self, message: RosMessage, info: MessageInfo, *, may_be_old: bool = False) -> None:
        """Send a message.

        Parameters
        ----------
        message, info
            As ROS gives them.
        may_be_old
            It may have been published long before, and says nothing of a clock.
        """
        with self._lock:
            self.received += 1
            self.losses.take(info["publication_sequence_number"])
            if self.fault:
                return
            if not info["received_timestamp"]:
                info["received_timestamp"] = time_ns()
            if not may_be_old:
                self.stamping.observe(message, info)
            if self._held or self.stamping.is_in_doubt:
                self._held.append((message, info))
                if self.stamping.is_in_doubt and len(self._held) < MAX_HELD:
                    return
                self._send_held()
            else:
                self._send(message, info)

    def look(self, now: float) -> None:
        """Do what is due; a few times a second, with the LSL time."""
        with self._lock:
            self.stamping.look(time_ns())
            if self._held and not self.stamping.is_in_doubt:
                self._send_held()
            for each in self._senders:
                each.look(now)
            if not self._senders and self._markers is not None:
                self._markers.look(now)
            self._say_wrong_clocks()

    def clock_was_set(self) -> None:
        """Judge the publishers' clocks anew: this computer's own one has jumped."""
        with self._lock:
            self.stamping.restart()
            self._said_wrong.clear()

    def end(self) -> None:
        """Send what is held, and nothing more."""
        with self._lock:
            self._send_held()
            self._senders, self._markers = [], None

    def _send_held(self) -> None:
        while self._held:
            self._send(*self._held.popleft())

    def _send(self, message: RosMessage, info: MessageInfo) -> None:
        stamped = self.stamping.stamp(message, info)
        self.newest_s = stamped.lsl_s
        try:
            for each in self._senders:
                each.send(message, stamped.lsl_s, lambda: self._origin_of(message, stamped.source))
        except GatewayError as error:
            self._fail(error)

    def _fail(self, error: GatewayError) -> None:
        self.fault = str(error)
        self._senders = []
        self._say(f"{error}; it is not sent")

    def _origin_of(self, message: RosMessage, source: StampSource) -> Origin:
        holders = (getattr(message, HEADER, None), message)
        frames = {
            name: str(getattr(holder, name))
            for name in FRAMES
            for holder in holders
            if hasattr(holder, name)
        }
        wrong = self.stamping.wrong_clocks
        clock, edge_s = ClockState.UNKNOWN, 0.0
        if wrong:
            clock, edge_s = ClockState.UNSYNCHRONISED, next(iter(wrong.values()))
        elif source in self.stamping.clocks:
            clock = self.stamping.clocks[source].state
        origin = Origin(self._origin.topic, self._origin.type_name, self._origin.type_hash, frames)
        return with_stamp(origin, source, clock, edge_s)

    def _marker_outlet(self) -> MarkerOutlet:
        if self._markers is None:
            self._markers = MarkerOutlet(self.request.name, self._origin)
        return self._markers

    def _say_wrong_clocks(self) -> None:
        for source, edge_s in self.stamping.wrong_clocks.items():
            if source not in self._said_wrong:
                self._said_wrong.add(source)
                self._say(wrong_clock(source, edge_s))


def wrong_clock(source: StampSource, edge_s: float) -> str:
    """Say that stamps are of a clock that is not synchronised, and what is done instead."""
    whose = {
        StampSource.HEADER: "the stamps in its headers are",
        StampSource.SOURCE: "the clock of its publisher is",
    }[source]
    direction = "ahead of" if edge_s < 0 else "behind"
    return (
        f"{whose} {abs(edge_s):.3f} s {direction} this computer's time, at least; they are not"
        " used: synchronise the clocks (chrony, PTP)"
    )
