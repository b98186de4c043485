"""Sends the messages of one topic."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import time_ns
from typing import Any

from biosensor_common.errors import GatewayError
from lsl_to_ros.accounts.ros_time import RosTime
from lsl_to_ros.ros_to_lsl.fields import (
    FRAMES,
    HEADER,
    FramedList,
    has_header,
)
from lsl_to_ros.ros_to_lsl.losses import PublicationLosses
from lsl_to_ros.ros_to_lsl.outlets import MarkerOutlet, Origin, with_stamp
from lsl_to_ros.ros_to_lsl.pairs import Pairs, parted
from lsl_to_ros.ros_to_lsl.publisher_clock import ClockState, Offset
from lsl_to_ros.ros_to_lsl.requests import SendAs, TopicRequest
from lsl_to_ros.ros_to_lsl.senders import NumberSender, Sender, senders_for
from lsl_to_ros.ros_to_lsl.stamping import Doubt, MessageStamping, StampSource, doubt_of, worst_of
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
    is_latched
        Whether its publishers keep their last messages for those who come later.
    """

    def __init__(
        self,
        request: TopicRequest,
        ros_time: RosTime,
        say: Callable[[str], None],
        *,
        by_arrival: bool,
        is_part: bool = False,
    ) -> None:
        self.request = request
        self.received, self.newest_s, self.fault = 0, 0.0, ""
        self.losses = PublicationLosses()
        self.stamping = MessageStamping(ros_time, has_header=False, by_arrival=by_arrival)
        self._ros_time, self._by_arrival = ros_time, by_arrival
        self._say = say
        # The clocks of the parts of a topic are said together.
        self._is_part = is_part
        self._lock = threading.Lock()
        self._origin = Origin(request.topic, request.type_name, stamp_source=self.stamping.expected)
        self._senders: list[Sender] = []
        self._markers: MarkerOutlet | None = None
        self.is_latched = False
        self._pairs = Pairs(request, self._new_part, say)
        self._list: FramedList | None = None
        self._held: deque[tuple[RosMessage, MessageInfo]] = deque()
        self._said_wrong: set[tuple[StampSource, ClockState]] = set()
        if request.send_as in (SendAs.MARKERS, SendAs.JSON):
            # Before anybody publishes: a recorder must see it before the first event.
            try:
                self._marker_outlet()
            except GatewayError as error:
                self._fail(error)

    @property
    def streams(self) -> Mapping[str, int]:
        """Samples or markers that were pushed, by stream."""
        own = {each.name: each.outlet.pushed for each in self._senders if each.outlet is not None}
        for each in self.parts:
            own |= each.streams
        return own

    @property
    def is_received(self) -> bool:
        """Whether anybody receives any of the streams."""
        outlets = [each.outlet for each in self._senders]
        own = any(outlet.have_consumers() for outlet in outlets if outlet is not None)
        return own or any(each.is_received for each in self.parts)

    @property
    def replaced(self) -> int:
        """How often an outlet made way for one with other channels."""
        senders = (each for each in self._senders if isinstance(each, NumberSender))
        own = sum(each.replaced for each in senders)
        return own + sum(each.replaced for each in self.parts)

    @property
    def parts(self) -> list[Bridge]:
        """One for each pair of frames, for a type that lists transforms."""
        return self._pairs.parts

    @property
    def left_out(self) -> int:
        """How many pairs of frames are not sent, because there are too many."""
        return len(self._pairs.left_out)

    @property
    def is_empty(self) -> bool:
        """Whether messages have come, and none had a number for a stream yet."""
        if self.fault or not self.received:
            return False
        waits = any(isinstance(each, NumberSender) and not each.outlet for each in self._senders)
        return waits if self._list is None else not self.streams

    @property
    def stampings(self) -> list[MessageStamping]:
        """Of the topic, or of its parts."""
        if self._list is None:
            return [self.stamping]
        return [each.stamping for each in self.parts]

    @property
    def doubtful_clocks(self) -> dict[StampSource, Doubt]:
        """Of the topic; of its parts the worst."""
        return worst_of(self.stampings)

    def take_offset(self, offset: Offset) -> None:
        """Take in what was measured of its publisher's clock."""
        with self._lock:
            for each in self.stampings:
                each.clocks[StampSource.SOURCE].take_offset(offset)

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
            self._list = parted(kind.message_class, self.request)
            if self._list is not None:
                return
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
            if self._list is not None:
                self._take_parts(message, info, may_be_old=may_be_old)
                return
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
                if self.is_latched and isinstance(each, NumberSender) and each.has_new_receiver():
                    each.repeat(self.stamping.after_all(now))
            for each in self.parts:
                each.look(now)
            if not self._senders and self._markers is not None:
                self._markers.look(now)
            self._say_wrong_clocks()

    def clock_was_set(self) -> None:
        """Judge the publishers' clocks anew: this computer's own one has jumped."""
        with self._lock:
            for each in self.stampings:
                each.restart()
            self._said_wrong.clear()

    def end(self) -> None:
        """Send what is held, and nothing more."""
        with self._lock:
            self._send_held()
            for each in self.parts:
                each.end()
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
        # A stream that will never have anything must not be in anybody's list.
        self._senders, self._markers = [], None
        self._say(f"{error}; it is not sent")

    def _take_parts(self, message: RosMessage, info: MessageInfo, *, may_be_old: bool) -> None:
        """Send each element of a list as a message of its own."""
        assert self._list is not None
        for element in getattr(message, self._list.name):
            part = self._pairs.part_of(element, self._list.element)
            if part is None:
                continue
            part.is_latched = self.is_latched
            part.take(element, info, may_be_old=may_be_old)
            self.newest_s = max(self.newest_s, part.newest_s)
            self.fault = self.fault or part.fault

    def _new_part(self, request: TopicRequest, kind: type[Any]) -> Bridge:
        part = Bridge(request, self._ros_time, self._say, by_arrival=self._by_arrival, is_part=True)
        part.connect(MessageType(request.type_name, "", kind))
        return part

    def _origin_of(self, message: RosMessage, source: StampSource) -> Origin:
        holders = (getattr(message, HEADER, None), message)
        frames = {
            name: str(getattr(holder, name))
            for name in FRAMES
            for holder in holders
            if hasattr(holder, name)
        }
        clocks = self.stamping.clocks
        doubts = self.stamping.doubtful_clocks
        suspect = next(iter(doubts)) if doubts else source
        state, edge_s = ClockState.UNKNOWN, math.nan
        if suspect in clocks:
            state, edge_s = clocks[suspect].state, clocks[suspect].bound_s
        origin = Origin(self._origin.topic, self._origin.type_name, self._origin.type_hash, frames)
        return with_stamp(origin, source, state, edge_s)

    def _marker_outlet(self) -> MarkerOutlet:
        if self._markers is None:
            self._markers = MarkerOutlet(self.request.name, self._origin)
        return self._markers

    def _say_wrong_clocks(self) -> None:
        for source, doubt in () if self._is_part else self.doubtful_clocks.items():
            if (source, doubt.state) not in self._said_wrong:
                self._said_wrong.add((source, doubt.state))
                self._say(doubt_of(source, doubt))
