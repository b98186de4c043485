"""Selects the stamp of a message, checks the clock behind it, and converts it to LSL time."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from enum import StrEnum, unique
from statistics import median
from typing import NamedTuple

from biosensor_common.clocks import MonotonicStamps
from biosensor_common.lower_envelope import LowerEnvelope
from biosensor_common.ros_clock import NS_PER_S
from lsl_to_ros.statistics.ros_time import RosTime
from lsl_to_ros.subscriber_thread import MessageInfo, RosMessage

AHEAD_S = 0.002
"""By how much a message may seem to arrive before it was sent: NTP's error in a lab network."""
WAY_S = 0.02
"""The fastest messages in a lab network take no longer; a larger delay may be the clock's error."""
BEHIND_S = 1.0
"""No network takes so long; a larger delay is the clock's error."""
SIMULATED_S = 60.0
"""Headers that are further off may be of simulated time."""
PATIENCE_S = 2.0
"""For this time, late messages may still be explained by a backlog."""
MOMENT_S, LONGEST_S, MOMENTS_S, LEAST_MOMENTS = 0.1, 2.0, 10.0, 10
"""Messages of one moment may have waited together; it lasts until the next one, at most 2 s. If
in most of the newest moments, at least so many, none came in time, the clock is behind, as one that
runs slow and is set again and again."""
EVEN_S, EVEN_MOMENTS, EVEN_FOR_S, APART_S = 0.005, 3, 2.0, 0.15
"""If messages that come apart, of so many moments in a row and over so long, are late by the same
to within 5 ms, the clock was set: of a topic of up to 5 Hz, stamps need not step back then."""
GROWING_MOMENTS = 4
"""If so many moments are later each by the same more, the clock runs slow. One more than above,
because a line through three delays of a network is more often found by chance."""
MOST_FALLS = 2
"""A clock that was right and fell behind so often is set again and again: it stays untrusted."""
_PERIOD_S = 1.0


@unique
class ClockState(StrEnum):
    """State of a publisher's clock."""

    UNKNOWN = "unknown"
    """No message yet, or only late ones for a short time."""
    SYNCHRONISED = "synchronised"
    """To within `WAY_S`, or by measurement."""
    BEHIND = "behind"
    """By up to the edge, of which an unknown part is transmission delay."""
    WRONG = "wrong"


class Offset(NamedTuple):
    """Bounds of a publisher's clock minus this computer's clock, in seconds."""

    least_s: float
    most_s: float


class PublisherClock:
    """Tracks the lower edge of arrival minus stamp: the smallest delay plus the clock offset.

    Delays are never negative, so the edge of a correct clock is just above 0. If it is higher, only
    a measurement can separate offset and delay. A clock that was wrong once stays untrusted; one
    that was right and then behind is trusted again when most messages come in time, once. A stamp
    that steps back shows at once that the clock was set, for messages keep their order.
    """

    def __init__(self) -> None:
        self.state = ClockState.UNKNOWN
        self.offset: Offset | None = None  # Measured offset; None without a measurement.
        self._first_delay_ns = self._first_arrival_ns = 0
        self._envelope: LowerEnvelope | None = None
        self._lowest = (0.0, math.inf)
        self._least_s = 0.0
        self._newest_s = self._period_begin_s = 0.0
        self._falls = self._moment = 0
        self._last_ns = 0, 0
        # Of the newest moments: how long each lasts until the next, and the smallest delay of each.
        self._lasts_s: deque[float] = deque()
        self._delays: deque[float] = deque()
        self._usual_s = 0.0

    @property
    def _was_right(self) -> bool:
        return self._falls > 0

    @property
    def is_in_doubt(self) -> bool:
        """Whether messages were received, but their delay may still be the network's."""
        return self._envelope is not None and self.state is ClockState.UNKNOWN

    @property
    def edge_s(self) -> float:
        """Lower edge of arrival minus stamp, in seconds; NaN before the first message.

        Of a clock that was right and is behind, the edge is the largest delay of a moment.
        """
        if self._envelope is None:
            return math.nan
        if self._was_right and self.state is ClockState.BEHIND:
            return max(self._delays)
        height_s = min(self._envelope.at(self._newest_s), self._lowest[1])
        # A line through the delays of a clock that was set would go on below all of them.
        return self._first_delay_ns / NS_PER_S + max(height_s, self._least_s)

    @property
    def bound_s(self) -> float:
        """Upper bound of how far the clock is behind, in s: the edge, or the measured offset."""
        if self.offset is not None and self.state is ClockState.SYNCHRONISED:
            return min(-self.offset.least_s, self.edge_s)
        return self.edge_s

    def observe(self, stamp_ns: int, arrival_ns: int, *, keep_order: bool = True) -> None:
        """Add the times of a message.

        Parameters
        ----------
        stamp_ns
            By the publisher's clock, in nanoseconds since 1970.
        arrival_ns
            By this computer's clock.
        keep_order
            Whether messages come in the order of their stamps, as those of one publisher do.
        """
        if self._envelope is None:
            self._begin(stamp_ns, arrival_ns)
        delay_ns = arrival_ns - stamp_ns
        passed_s = (arrival_ns - self._first_arrival_ns) / NS_PER_S
        height_s = (delay_ns - self._first_delay_ns) / NS_PER_S
        delay_s = delay_ns / NS_PER_S
        self._newest_s = max(self._newest_s, passed_s)
        self._least_s = min(self._least_s, height_s)
        if height_s < self._lowest[1]:
            self._lowest = passed_s, height_s
        if passed_s - self._period_begin_s > _PERIOD_S and self._envelope is not None:
            # Only the lowest point of each second, because a fit takes longer than all other work.
            self._envelope.add(*self._lowest)
            self._lowest, self._period_begin_s = (0.0, math.inf), passed_s
        self._add_to_moment(delay_s, arrival_ns)
        self._judge(delay_s)
        # If the clock was measured to be right, late messages are due to the network.
        is_right = self.state is ClockState.SYNCHRONISED and self.offset is None
        limit_s = WAY_S if is_right else BEHIND_S
        last_stamp_ns, last_arrival_ns = self._last_ns
        back_s = (last_stamp_ns - stamp_ns) / NS_PER_S
        is_later = keep_order and arrival_ns >= last_arrival_ns
        has_stepped = is_later and min(back_s, delay_s) > WAY_S
        self._last_ns = stamp_ns, arrival_ns
        if self.state is ClockState.SYNCHRONISED and has_stepped:
            # What was measured, and how late messages were, is of the time before.
            self.offset = None
            self._forget_delays(delay_s)
            self._fall(stamp_ns, arrival_ns)
        elif is_right and self._is_evenly_late:
            self._forget_delays(delay_s)
            self._fall(stamp_ns, arrival_ns)
        elif self.state is not ClockState.WRONG and self._usual_s > limit_s:
            self._fall(stamp_ns, arrival_ns)

    @property
    def _is_evenly_late(self) -> bool:
        """Whether the newest moments were late by the same, or more and more so at an even pace."""
        for_s = 0.0
        ages_s: list[float] = []
        delays: list[float] = []
        for lasts_s, delay_s in zip(reversed(self._lasts_s), reversed(self._delays), strict=True):
            if delay_s <= WAY_S or (delays and lasts_s <= APART_S):
                return False
            ages_s.append(for_s)
            delays.append(delay_s)
            if len(delays) >= EVEN_MOMENTS and for_s >= EVEN_FOR_S:
                is_growing = len(delays) >= GROWING_MOMENTS and _grows_evenly(ages_s, delays)
                if is_growing or max(delays) - min(delays) <= EVEN_S:
                    return True
                if len(delays) >= GROWING_MOMENTS:
                    return False
            for_s += lasts_s
        return False

    def _fall(self, stamp_ns: int, arrival_ns: int) -> None:
        self._falls += self.state is not ClockState.BEHIND
        self.state = _late_state(self._usual_s)
        self._begin(stamp_ns, arrival_ns)

    def _add_to_moment(self, delay_s: float, arrival_ns: int) -> None:
        moment = arrival_ns // round(MOMENT_S * NS_PER_S)
        if moment == self._moment:
            self._delays[-1] = min(self._delays[-1], delay_s)
            return  # nothing is dropped: it came with others
        if len(self._delays) >= LEAST_MOMENTS:
            self._usual_s = median(self._delays)
        # A pause tells nothing, so it does not make the delays before it old.
        self._lasts_s.append(min(LONGEST_S, (moment - self._moment) * MOMENT_S))
        self._delays.append(delay_s)
        while len(self._delays) > LEAST_MOMENTS and math.fsum(self._lasts_s) > MOMENTS_S:
            self._lasts_s.popleft()
            self._delays.popleft()
        self._moment = moment

    def _forget_delays(self, delay_s: float) -> None:
        self._delays, self._lasts_s = deque([delay_s]), deque([0.0])
        self._usual_s = delay_s

    def _begin(self, stamp_ns: int, arrival_ns: int) -> None:
        self._first_delay_ns, self._first_arrival_ns = arrival_ns - stamp_ns, arrival_ns
        self._envelope, self._lowest = LowerEnvelope(0.0), (0.0, math.inf)
        self._least_s = 0.0
        self._newest_s = self._period_begin_s = 0.0

    def look(self, now_ns: int) -> None:
        """Update the state by the elapsed time, also without new messages."""
        if self.is_in_doubt:
            passed_s = (now_ns - self._first_arrival_ns) / NS_PER_S
            if passed_s > PATIENCE_S:
                self.state = _late_state(self.edge_s)

    def take_offset(self, offset: Offset) -> None:
        """Store the measured offset of the publisher's clock."""
        if self._was_right and self.state is ClockState.BEHIND and self._delays[-1] <= WAY_S:
            return  # nothing is dropped: at this moment it is right, which explains no late ones
        self.offset = offset
        if offset.least_s > AHEAD_S or offset.most_s < -WAY_S:
            self.state = ClockState.WRONG
        elif offset.least_s >= -WAY_S and self.state is not ClockState.WRONG:
            self.state = ClockState.SYNCHRONISED

    def _judge(self, delay_s: float) -> None:
        if delay_s < -AHEAD_S:
            self.state = ClockState.WRONG
        elif self.state in (ClockState.UNKNOWN, ClockState.BEHIND):
            if delay_s <= WAY_S and not self._was_right:
                self.state = ClockState.SYNCHRONISED
                # They came late by the way.
                self._forget_delays(delay_s)
            elif 0 < self._falls < MOST_FALLS and self._usual_s <= WAY_S:
                self.state = ClockState.SYNCHRONISED
            elif self.state is ClockState.UNKNOWN and self._newest_s > PATIENCE_S:
                self.state = _late_state(self.edge_s)


def _grows_evenly(ages_s: Sequence[float], delays: Sequence[float]) -> bool:
    """Whether delays, from the newest to the oldest, are on a line that rises with time."""
    slope = (delays[0] - delays[-1]) / ages_s[-1]
    apart = (
        abs(delay_s - delays[0] + slope * age_s)
        for age_s, delay_s in zip(ages_s, delays, strict=True)
    )
    return slope > 0 and max(apart) <= EVEN_S


def _late_state(edge_s: float) -> ClockState:
    return ClockState.BEHIND if edge_s <= BEHIND_S else ClockState.WRONG


@unique
class StampSource(StrEnum):
    """Source of a sample's stamp."""

    HEADER = "header"
    """``header.stamp`` of the message: the time of measurement, by the publisher."""
    SOURCE = "source"
    """The time of publication, by the publisher's middleware."""
    ARRIVAL = "arrival"
    """The time of arrival at this computer."""


class Stamped(NamedTuple):
    """The stamp of one message."""

    lsl_s: float  # Stamp on this computer's LSL clock.
    source: StampSource


class Doubt(NamedTuple):
    """State of a clock that may differ from this computer's clock."""

    state: ClockState
    edge_s: float  # Lower edge of arrival minus stamp, in seconds.
    offset: Offset | None  # Measured offset; None without a measurement.
    is_used: bool  # Whether its stamps are used nevertheless.
    is_mixed: bool = False  # Whether it is the clock of one of several publishers.


class MessageStamping:
    """The stamps of one topic.

    Uses the first source that the message has, unless its clock is known to be wrong.

    Parameters
    ----------
    ros_time
        Converts this computer's clock to LSL time.
    by_arrival
        Use the time of arrival only.
    """

    def __init__(self, ros_time: RosTime, *, has_header: bool, by_arrival: bool) -> None:
        self._ros_time = ros_time
        self._has_header, self._by_arrival = has_header and not by_arrival, by_arrival
        self._monotonic = MonotonicStamps()
        # Whether several publishers send the messages. Nobody can tell which is whose, so each
        # stamp is compared with its own arrival, and not used if it is too far from that.
        self.is_mixed = False
        self._strays: dict[StampSource, float] = {}
        self.clocks = _new_clocks()  # Clocks of the header's stamps and of the middleware's.
        self.sources = dict.fromkeys(StampSource, 0)  # Number of messages per source.

    @property
    def expected(self) -> StampSource:
        """The usual source of stamps for messages of this type."""
        if self._by_arrival:
            return StampSource.ARRIVAL
        return StampSource.HEADER if self._has_header else StampSource.SOURCE

    @property
    def moved(self) -> int:
        """Number of stamps that were moved behind their predecessor."""
        return self._monotonic.corrections

    @property
    def doubtful_clocks(self) -> dict[StampSource, Doubt]:
        """Clocks that are not, or may not be, synchronised."""
        strays = {
            source: Doubt(_late_state(abs(stray_s)), stray_s, None, is_used=False, is_mixed=True)
            for source, stray_s in self._strays.items()
        }
        return strays | {
            source: Doubt(clock.state, clock.edge_s, clock.offset, is_used=self._trusts(source))
            for source, clock in self.clocks.items()
            if clock.state in (ClockState.BEHIND, ClockState.WRONG)
        }

    @property
    def wants_offset(self) -> bool:
        """Whether only a measurement can decide if the publisher's clock is right."""
        clock = self.clocks[StampSource.SOURCE]
        return clock.is_in_doubt or clock.state is ClockState.BEHIND or clock.offset is not None

    def observe(self, message: RosMessage, info: MessageInfo) -> None:
        """Compare a message's stamps with its arrival."""
        if self._by_arrival:
            return  # nothing is dropped: its stamps are not used
        arrival_ns = info["received_timestamp"]
        if self._has_header and (stamp_ns := _header_ns(message)):
            self._observe(StampSource.HEADER, stamp_ns, arrival_ns)
        if info["source_timestamp"]:
            self._observe(StampSource.SOURCE, info["source_timestamp"], arrival_ns)

    def _observe(self, source: StampSource, stamp_ns: int, arrival_ns: int) -> None:
        self.clocks[source].observe(stamp_ns, arrival_ns, keep_order=not self.is_mixed)

    def look(self, now_ns: int) -> None:
        """Update the clocks' states by the elapsed time."""
        for clock in self.clocks.values():
            clock.look(now_ns)

    @property
    def is_in_doubt(self) -> bool:
        """Whether it is still unknown if a clock is right."""
        return any(clock.is_in_doubt for clock in self.clocks.values())

    def restart(self) -> None:
        """Start again with all clocks, because this computer's clock was set."""
        self.clocks = _new_clocks()
        self._strays.clear()

    def choose(self, message: RosMessage, info: MessageInfo) -> StampSource:
        """Return the source of a message's stamp."""
        return self._chosen(message, info)[0]

    def stamp(self, message: RosMessage, info: MessageInfo) -> Stamped:
        """Return a message's LSL time, later than that of the previous message."""
        source, stamp_ns = self._chosen(message, info)
        self.sources[source] += 1
        (lsl_s,) = self._monotonic.apply([self._ros_time.to_lsl_s(stamp_ns)])
        return Stamped(lsl_s, source)

    def after_all(self, lsl_s: float) -> float:
        """Return an LSL time, moved behind the stamps of all messages so far."""
        (stamp,) = self._monotonic.apply([lsl_s])
        return stamp

    def _chosen(self, message: RosMessage, info: MessageInfo) -> tuple[StampSource, int]:
        """Return the source and the stamp in nanoseconds since 1970."""
        arrival_ns = info["received_timestamp"]
        source_ns = 0 if self._by_arrival else info["source_timestamp"]
        is_source_right = self._is_near(StampSource.SOURCE, source_ns, arrival_ns)
        is_headed = self._has_header and self._trusts(StampSource.HEADER)
        if is_headed and (stamp_ns := _header_ns(message)):
            # As in `_trusts`: it is older than its publication.
            most_s = BEHIND_S if source_ns and is_source_right else WAY_S
            if self._is_near(StampSource.HEADER, stamp_ns, arrival_ns, most_s):
                return StampSource.HEADER, stamp_ns
        if source_ns and is_source_right and self._trusts(StampSource.SOURCE):
            return StampSource.SOURCE, source_ns
        return StampSource.ARRIVAL, arrival_ns

    def _is_near(
        self, source: StampSource, stamp_ns: int, arrival_ns: int, most_s: float = WAY_S
    ) -> bool:
        """Whether a stamp is near its arrival; one publisher is judged by all of its messages."""
        late_s = (arrival_ns - stamp_ns) / NS_PER_S
        if not self.is_mixed or not stamp_ns or -AHEAD_S <= late_s <= most_s:
            return True
        self._strays[source] = max(self._strays.get(source, 0.0), late_s, key=abs)
        return False

    def _trusts(self, source: StampSource) -> bool:
        state = self.clocks[source].state
        if source is StampSource.HEADER and state is ClockState.BEHIND:
            # The message was measured before it was published, by a computer whose clock is right.
            return self.clocks[StampSource.SOURCE].state is ClockState.SYNCHRONISED
        return state in (ClockState.UNKNOWN, ClockState.SYNCHRONISED)


def worst_of(stampings: Sequence[MessageStamping]) -> dict[StampSource, Doubt]:
    """Return the largest error of each clock over several stampings of one topic."""
    worst: dict[StampSource, Doubt] = {}
    for each in stampings:
        for source, doubt in each.doubtful_clocks.items():
            known = worst.get(source, doubt)
            worst[source] = max(known, doubt, key=lambda one: abs(one.edge_s))
    return worst


def doubt_of(source: StampSource, doubt: Doubt) -> str:
    """Return a sentence about a clock that may be wrong, and whether its stamps are used."""
    if doubt.is_used:
        return (
            f"the timestamps in its headers are up to {doubt.edge_s:.3f} s older than their "
            "arrival; they are used, because its publisher's clock is right"
        )
    if doubt.is_mixed:
        before_after = "after" if doubt.edge_s < 0 else "before"
        what = "headers" if source is StampSource.HEADER else "publishers' clocks"
        return (
            f"by their {what}, some messages of its several publishers are from up to "
            f"{abs(doubt.edge_s):.3f} s {before_after} their arrival; these get their time of "
            "arrival: synchronise the clocks (chrony, PTP)"
        )
    whose = {
        StampSource.HEADER: "the timestamps in its headers are",
        StampSource.SOURCE: "the clock of its publisher is",
    }[source]
    advice = "synchronise the clocks (chrony, PTP)"
    if source is StampSource.HEADER and abs(doubt.edge_s) > SIMULATED_S:
        advice = f"if its node uses simulated time (use_sim_time), switch that off; else {advice}"
    return f"{whose} {_how_far(doubt)}; they are not used: {advice}"


def _how_far(doubt: Doubt) -> str:
    if doubt.state is ClockState.BEHIND:
        return f"behind by up to {doubt.edge_s:.3f} s, unless messages take that long to arrive"
    if doubt.offset is not None:
        middle_s = (doubt.offset.least_s + doubt.offset.most_s) / 2
        direction = "ahead of" if middle_s > 0 else "behind"
        return f"{abs(middle_s):.3f} s {direction} this computer's time, as measured"
    direction = "ahead of" if doubt.edge_s < 0 else "behind"
    return f"at least {abs(doubt.edge_s):.3f} s {direction} this computer's time"


def _header_ns(message: RosMessage) -> int:
    stamp = message.header.stamp
    return stamp.sec * NS_PER_S + stamp.nanosec


def _new_clocks() -> dict[StampSource, PublisherClock]:
    return {source: PublisherClock() for source in (StampSource.HEADER, StampSource.SOURCE)}
