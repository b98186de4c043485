"""Sends the messages of one topic as LSL streams."""

from __future__ import annotations

import math
import re
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import count
from time import time_ns
from typing import Any, Generic, TypeVar

from biosensor_common.errors import GatewayError
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.ros.layout import is_part
from lsl_to_ros.ros_to_lsl.class_fields import (
    FramedList,
    framed_list,
    frames_of,
    has_header,
    type_name,
)
from lsl_to_ros.ros_to_lsl.parameters import SendAs, TopicRequest
from lsl_to_ros.ros_to_lsl.senders import MarkerSender, NumberSender, Sender, senders_for
from lsl_to_ros.ros_to_lsl.stamps import (
    ClockState,
    Doubt,
    MessageStamping,
    Offset,
    StampSource,
    doubt_of,
    worst_of,
)
from lsl_to_ros.ros_to_lsl.topic_outlets import MarkerOutlet, Origin, with_stamp
from lsl_to_ros.statistics.ros_time import RosTime
from lsl_to_ros.subscriber_thread import MessageInfo, RosMessage

MAX_HELD = 5000
"""Largest number of messages that wait while a clock is in doubt."""
OLD_MESSAGES_S = 1.0
"""A latched topic's old messages reach a new subscriber within this time, and may be of any age."""


SAID_AGAIN_S = 1.0
"""Losses and changes of channels are logged each time, so that recorded events have them all."""
_WHAT = {
    StampSource.HEADER: Refusal.DOUBTFUL_STAMPS,
    StampSource.SOURCE: Refusal.DOUBTFUL_CLOCK,
}
MAX_PAIRS = 200
"""Largest number of pairs of frames of one topic that become streams, each with an outlet."""
_NO_NAME = re.compile(r"[^A-Za-z0-9_-]+")
Part = TypeVar("Part")


class Doubts:
    """The reports about the clocks of one topic."""

    def __init__(self, refusals: Refusals) -> None:
        self._refusals = refusals
        self._said: set[tuple[StampSource, ClockState]] = set()

    def tell(self, doubtful: Mapping[StampSource, Doubt]) -> None:
        """Report the doubtful clocks."""
        for source, what in _WHAT.items():
            doubt = doubtful.get(source)
            if doubt is None or (source, doubt.state) not in self._said:
                self._refusals.over(what)
            if doubt is not None:
                self._said.add((source, doubt.state))
                self._refusals.refuse(what, why=doubt_of(source, doubt))

    def restart(self) -> None:
        """Report everything again after a step of this computer's clock."""
        self._said.clear()


@dataclass(frozen=True, slots=True)
class MessageType:
    """The type of a topic's messages."""

    name: str
    hash: str
    message_class: type[Any]


class Bridge:
    """Sends one topic's messages to its streams; thread-safe.

    Parameters
    ----------
    say
        Called with sentences about the topic for the user.
    whole
        The bridge of the whole topic, if this one is for a part of it.

    Attributes
    ----------
    newest_s
        LSL time of the newest message, 0 before the first.
    """

    def __init__(
        self,
        request: TopicRequest,
        ros_time: RosTime,
        say: Callable[[str], None],
        *,
        by_arrival: bool,
        whole: Bridge | None = None,
    ) -> None:
        self.request = request
        self.received, self.newest_s, self._fault = 0, 0.0, ""
        self._is_part = whole is not None
        # Reports of data that is not sent unchanged.
        self.refusals = whole.refusals if whole else Refusals(say, again_s=SAID_AGAIN_S)
        self.losses = PublicationLosses()
        self.stamping = MessageStamping(ros_time, has_header=False, by_arrival=by_arrival)
        self._ros_time, self._by_arrival = ros_time, by_arrival
        self._say = say
        self._lock = threading.Lock()
        self._origin = Origin(request.topic, request.type_name, stamp_source=self.stamping.expected)
        self._senders: list[Sender] = []
        self._markers: MarkerOutlet | None = None
        # Whether its publishers keep their last messages for late subscribers.
        self.is_latched = False
        self._pairs = Pairs(request, self._new_part, self.refusals)
        self._list: FramedList | None = None
        self._held: deque[tuple[RosMessage, MessageInfo]] = deque()
        self._doubts = Doubts(self.refusals)
        if request.send_as in (SendAs.MARKERS, SendAs.JSON):
            # Opened before anybody publishes: a recorder must see it before the first event.
            try:
                self._marker_outlet()
            except GatewayError as error:  # nothing is dropped: `_fail` reports it
                self._fail(error)

    @property
    def streams(self) -> Mapping[str, int]:
        """Number of samples or markers that were pushed, by stream."""
        own = {each.name: each.outlet.pushed for each in self._senders if each.outlet is not None}
        for each in self.parts:
            own |= each.streams
        return own

    @property
    def sends_numbers(self) -> bool:
        """Whether it is one stream of numbers."""
        return any(isinstance(each, NumberSender) for each in self._senders)

    @property
    def is_received(self) -> bool:
        """Whether any of the streams has a receiver."""
        outlets = [each.outlet for each in self._senders]
        own = any(outlet.have_consumers() for outlet in outlets if outlet is not None)
        return own or any(each.is_received for each in self.parts)

    @property
    def source_ids(self) -> set[str]:
        """The source_ids of its present outlets."""
        outlets = (each.outlet for each in self._senders)
        own = {outlet.source_id for outlet in outlets if outlet is not None}
        return own.union(*(each.source_ids for each in self.parts))

    @property
    def replaced(self) -> int:
        """How often an outlet was replaced by one with other channels."""
        senders = (each for each in self._senders if isinstance(each, NumberSender))
        own = sum(each.replaced for each in senders)
        return own + sum(each.replaced for each in self.parts)

    @property
    def parts(self) -> list[Bridge]:
        """The bridges per pair of frames, for a type that lists transforms."""
        return self._pairs.parts

    @property
    def left_out(self) -> int:
        """Number of pairs of frames that are not sent, because there are too many."""
        return len(self._pairs.left_out)

    @property
    def fault(self) -> str:
        """Why nothing is sent; empty if messages are sent."""
        return self._fault

    def refuse(self, reason: str) -> None:
        """Send nothing while there is a reason; an empty text ends that."""
        self._fault = reason
        self.refusals.hold(Refusal.NOT_SENT, bool(reason), why=reason)

    @property
    def stampings(self) -> list[MessageStamping]:
        """The stampings of the topic, or of its parts."""
        if self._list is None:
            return [self.stamping]
        return [each.stamping for each in self.parts]

    @property
    def doubtful_clocks(self) -> dict[StampSource, Doubt]:
        """The doubtful clocks of the topic; the worst ones of its parts."""
        return worst_of(self.stampings)

    def take_offset(self, offset: Offset) -> None:
        """Store the measured offset of its publisher's clock."""
        with self._lock:
            for each in self.stampings:
                each.clocks[StampSource.SOURCE].take_offset(offset)

    def connect(self, kind: MessageType) -> None:
        """Prepare for messages of a type."""
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
                # nothing is dropped: each pair of frames gets senders of its own
                return
            try:
                self._senders = senders_for(
                    kind.message_class, self.request, self._marker_outlet, self.refusals
                )
            except GatewayError as error:  # nothing is dropped: `_fail` reports it
                self._fail(error)

    def take(self, message: RosMessage, info: MessageInfo, *, may_be_old: bool = False) -> None:
        """Send a message.

        Parameters
        ----------
        may_be_old
            Whether it may have been published long ago, so that it shows nothing about a clock.
        """
        with self._lock:
            self.received += 1
            self.losses.take(info["publication_sequence_number"])
            if info.get("is_cut"):
                self.refusals.refuse(Refusal.CUT)
            if self.fault:
                self.refuse(self.fault)
                return
            if not info["received_timestamp"]:
                info["received_timestamp"] = time_ns()
            if self._list is not None:
                self._take_parts(message, info, may_be_old=may_be_old)
                return  # nothing is dropped: its elements are sent
            if not may_be_old:
                self.stamping.observe(message, info)
            if self._held or self.stamping.is_in_doubt:
                self._held.append((message, info))
                if self.stamping.is_in_doubt and len(self._held) < MAX_HELD:
                    # nothing is dropped: it is held
                    return
                self._send_held()
            else:
                self._send(message, info)

    def look(self, now: float) -> None:
        """Do scheduled work; call it a few times a second with the LSL time."""
        with self._lock:
            self.stamping.look(time_ns())
            if self._held and not self.stamping.is_in_doubt:
                self._send_held()
            for each in self._senders:
                if isinstance(each, MarkerSender):
                    each.outlet.is_state = self.is_latched
                each.look(now)
                if self.is_latched and isinstance(each, NumberSender) and each.has_new_receiver():
                    each.repeat(self.stamping.after_all(now))
            for each in self.parts:
                each.look(now)
            if not self._senders and self._markers is not None:
                self._markers.look(now)
            self.judge_clocks()

    def clock_was_set(self) -> None:
        """Check the publishers' clocks again, after a step of this computer's clock."""
        with self._lock:
            for each in self.stampings:
                each.restart()
            self._doubts.restart()

    def end(self) -> None:
        """Send the messages that are held, and stop."""
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
        except GatewayError as error:  # nothing is dropped: `_fail` reports it
            self._fail(error)

    def _fail(self, error: GatewayError) -> None:
        self.refuse(str(error))
        # A stream that will never have samples must not be listed.
        self._senders, self._markers = [], None

    def _take_parts(self, message: RosMessage, info: MessageInfo, *, may_be_old: bool) -> None:
        """Send each element of a list as a separate message."""
        assert self._list is not None
        elements = getattr(message, self._list.name)
        self.refusals.hold(Refusal.NO_NUMBER, not (elements or self.parts))
        for element in elements:
            part = self._pairs.part_of(element, self._list.element)
            if part is None:
                # nothing is dropped: `part_of` reports it
                continue
            part.is_latched = self.is_latched
            part.take(element, info, may_be_old=may_be_old)
            self.newest_s = max(self.newest_s, part.newest_s)
            self._fault = self._fault or part.fault

    def _new_part(self, request: TopicRequest, kind: type[Any]) -> Bridge:
        part = Bridge(request, self._ros_time, self._say, by_arrival=self._by_arrival, whole=self)
        part.connect(MessageType(request.type_name, "", kind))
        return part

    def _origin_of(self, message: RosMessage, source: StampSource) -> Origin:
        clocks = self.stamping.clocks
        doubts = self.stamping.doubtful_clocks
        suspect = next(iter(doubts)) if doubts else source
        state, edge_s = ClockState.UNKNOWN, math.nan
        if suspect in clocks:
            state, edge_s = clocks[suspect].state, clocks[suspect].bound_s
        origin = Origin(
            self._origin.topic, self._origin.type_name, self._origin.type_hash, frames_of(message)
        )
        return with_stamp(origin, source, state, edge_s)

    def _marker_outlet(self) -> MarkerOutlet:
        if self._markers is None:
            self._markers = MarkerOutlet(self.request.name, self._origin)
        return self._markers

    def judge_clocks(self) -> None:
        """Report clocks that may be wrong."""
        if not self._is_part:
            self._doubts.tell(self.doubtful_clocks)


class PublicationLosses:
    """Counts lost messages from the sequence numbers of a publisher.

    Each publisher has its own numbers, and a message does not name its publisher, so losses are
    unknown with two publishers on a topic. So missing numbers are only counted at the next check,
    if there is still one publisher.
    """

    def __init__(self) -> None:
        self._newest: int | None = None
        self._missing = 0
        self._lost = 0
        self._is_unknown = False

    @property
    def lost(self) -> int | None:
        """Lost messages since the first one; None if unknown."""
        return None if self._is_unknown else self._lost

    def take(self, number: int | None) -> None:
        """Add the number of a message; None if the middleware has none."""
        if number is None:
            self._is_unknown = True
            return  # nothing is dropped: this counts only
        # A smaller number belongs to a publisher that was restarted.
        if self._newest is not None and number > self._newest + 1:
            self._missing += number - self._newest - 1
        self._newest = number

    def look(self, publishers: int) -> int:
        """Update the number of publishers; return the number of newly lost messages."""
        if publishers > 1:
            self._is_unknown = True
        new, self._missing = self._missing, 0
        if self._is_unknown:
            return 0
        self._lost += new
        return new


class Pairs(Generic[Part]):
    """The parts of one topic, by frames.

    Parameters
    ----------
    make
        Makes the part for a request and a message class.
    """

    def __init__(
        self,
        request: TopicRequest,
        make: Callable[[TopicRequest, type[Any]], Part],
        refusals: Refusals,
    ) -> None:
        self._request, self._make, self._refusals = request, make, refusals
        self._parts: dict[tuple[str, str], Part] = {}
        self._names: set[str] = set()
        # Number of pairs of frames that are not sent, because there are too many.
        self.left_out: set[tuple[str, str]] = set()

    @property
    def parts(self) -> list[Part]:
        """The present parts."""
        return list(self._parts.values())

    def part_of(self, element: RosMessage, kind: type[Any]) -> Part | None:
        """Return the part of an element; None if there are too many."""
        pair = (element.header.frame_id, element.child_frame_id)
        if pair not in self._parts and len(self._parts) >= MAX_PAIRS:
            self.left_out.add(pair)
            self._refusals.refuse(Refusal.TOO_MANY_PAIRS, len(self.left_out), most=MAX_PAIRS)
            return None
        if pair not in self._parts:
            request = replace(self._request, name=self._name(pair), type_name=type_name(kind))
            self._parts[pair] = self._make(request, kind)
        return self._parts[pair]

    def _name(self, pair: tuple[str, str]) -> str:
        # Slashes of frames are replaced in names of streams, so two pairs may look alike.
        plain = "-".join((self._request.name, *(_NO_NAME.sub("-", each) for each in pair)))
        names = (plain if number == 1 else f"{plain}-{number}" for number in count(1))
        name = next(each for each in names if each not in self._names)
        self._names.add(name)
        return name


def parted(message_class: type[Any], request: TopicRequest) -> FramedList | None:
    """Return the list field whose elements become streams; None if the topic is sent as a whole."""
    found = framed_list(message_class)
    if found is None or request.send_as in (SendAs.MARKERS, SendAs.JSON):
        return None  # nothing is dropped: it is sent as a whole
    return None if any(is_part(each, found.name) for each in request.fields) else found
