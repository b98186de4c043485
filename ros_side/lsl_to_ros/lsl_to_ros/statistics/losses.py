"""Counts a stream's received, lost and refused samples.

Losses of other programs' regular streams are estimated from gaps between stamps; for our streams
the agent counts them. Once a second it reports how many samples of each stream it has pushed, up
to which stamp, and how many it lost before. The difference to the samples that were pulled up to
that stamp was lost in LSL. The comparison waits
until the stream has passed the stamp: both come over connections of their own,
and samples that were pushed together may have one stamp.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from biosensor_common.lsl.inlet import Stamps
from biosensor_common.quantities import ChannelFormat
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.ros.messages import AgentSays
from biosensor_common.stream_header import StreamHeader

# Two samples whose stamps are further apart than this many periods are not neighbours.
GAP_PERIODS = 1.5
# Other programs often use the time of the push as stamp, so their stamps jitter.
FOREIGN_JITTER_S = 0.1
# Within this part of a period, two stamps count as equal: the sender stamps on arrival.
AT_ONCE = 0.1
# A larger step back is another clock's.
STEP_BACK_S = 1.0
# What was seen last says how long bursts are, and by how much stamps overlap.
_REMEMBERED, _FEWEST_BURSTS = 16, 5
_JITTERS = 2.0
# A step to another clock must not give a count that no message can hold.
MOST_MISSING = 1_000_000_000
# Up to this number of stamps, a loop is faster than numpy.
FEW = 32


class Gap(NamedTuple):
    """A gap before one sample of a block."""

    place: int  # Index of the first sample after the gap.
    missing: int  # Estimated number of missing samples; 0 if that is known only with the next ones.


class GapFinder:
    """Finds gaps between the stamps of one stream, in the order of arrival.

    Other programs may stamp on arrival, many samples at once. There, a gap is a step that is longer
    than a burst and twice the largest jitter seen lately.

    Parameters
    ----------
    rate
        Nominal rate in Hz; an irregular stream (0) has no gaps.
    foreign
        Whether the stamps are another program's and therefore may jitter.
    """

    def __init__(self, rate: float, *, foreign: bool) -> None:
        self._last: float | None = None
        self._rate = rate
        jitter = FOREIGN_JITTER_S if foreign else 0.0
        self._longest_step = max(GAP_PERIODS / rate, jitter) if rate > 0 else math.inf
        self._at_once = AT_ONCE / rate if foreign and rate > 0 else -math.inf
        self._burst = 1
        # nothing is dropped: these are memories of how samples came, and hold no samples
        self._bursts: deque[int] = deque(maxlen=_REMEMBERED)
        self._doubtful_s = 0.0
        self._jitters: deque[float] = deque(maxlen=_REMEMBERED)  # nothing is dropped: as above

    @property
    def last_stamp(self) -> float:
        """Newest finite stamp; 0 before the first."""
        return self._last or 0.0

    def find(self, stamps: Stamps) -> list[Gap]:
        """Add the stamps of a block; return its gaps."""
        if len(stamps) == 1:
            return self._find_one(0, stamps.item())
        if len(stamps) <= FEW or self._bursts or self._jitters or self._burst > 1:
            stepwise = enumerate(stamps.tolist())
            return [gap for place, stamp in stepwise for gap in self._find_one(place, stamp)]
        finite = np.flatnonzero(np.isfinite(stamps))
        if not len(finite):
            return []  # nothing is dropped: NaN stamps are reported where they are published
        times = stamps[finite]
        before = -np.inf if self._last is None else self._last
        with np.errstate(over="ignore"):
            is_odd = np.diff(times, prepend=before) <= self._at_once
        if is_odd.any():
            stepwise = enumerate(stamps.tolist())
            return [gap for place, stamp in stepwise for gap in self._find_one(place, stamp)]
        previous, self._last = self._last, float(times[-1])
        if math.isinf(self._longest_step):
            return []  # nothing is dropped: an irregular stream has no gaps
        with np.errstate(over="ignore"):
            steps = np.diff(times, prepend=times[0] if previous is None else previous)
        places = np.flatnonzero(steps > self._longest_step)
        return [self._gap(int(finite[at]), float(steps[at])) for at in places]

    def _find_one(self, place: int, stamp: float) -> list[Gap]:
        if not math.isfinite(stamp):
            return []  # nothing is dropped: as above
        previous, self._last = self._last, stamp
        if previous is None:
            return []  # nothing is dropped: there is no gap
        step_s = stamp - previous
        if step_s <= self._at_once:
            if step_s >= -self._at_once:
                self._burst += 1
            elif step_s >= -STEP_BACK_S:
                self._jitters.append(-step_s)
            return []  # nothing is dropped: as above
        burst = self._next_burst()
        allowed_s = self._longest_step + _JITTERS * max(self._jitters, default=0.0)
        if burst > 1:
            allowed_s += burst / self._rate
        # The first burst may have begun before anybody listened, and a few tell the jitter.
        is_known = burst == 1 or len(self._bursts) >= _FEWEST_BURSTS
        if burst == 1:
            return [self._gap(place, step_s)] if step_s > allowed_s else []
        excess_s = step_s - burst / self._rate
        found = self._settle(place, excess_s)
        if is_known and step_s > allowed_s:
            # Nothing is counted yet, for the burst may only be very late.
            self._doubtful_s = excess_s
            found = [Gap(place, sum(each.missing for each in found))]
        elif len(self._bursts) > 1:
            self._jitters.append(abs(excess_s))
        return found

    def _settle(self, place: int, excess_s: float) -> list[Gap]:
        """Count the samples missing before the last burst, unless this one came early."""
        doubtful_s, self._doubtful_s = self._doubtful_s, 0.0
        missing = round(min(doubtful_s * self._rate, MOST_MISSING))
        return [Gap(place, missing)] if missing and -excess_s < doubtful_s / 2 else []

    def _next_burst(self) -> int:
        """End a burst; return the usual length of bursts, 1 if samples come singly."""
        if self._burst > 1 or self._bursts:
            self._bursts.append(self._burst)
        self._burst = 1
        return max(self._bursts, default=1)

    def _gap(self, place: int, step_s: float) -> Gap:
        periods = step_s * self._rate
        return Gap(place, round(min(periods, MOST_MISSING)) - 1)


_RECENT = 2048
_WAITING = 16


class _Report(NamedTuple):
    pushed: int
    lost: int
    last_stamp: float


@dataclass(frozen=True, slots=True)
class Losses:
    """Samples missing from one stream."""

    device: int  # Lost between sensor and agent, since the start of the first agent.
    transport: int  # Lost between agent and this node since it first attached.

    @property
    def total(self) -> int:
        """Sum of the samples lost before the agent and in LSL."""
        return self.device + self.transport


class CountersComparison:
    """Compares one stream's pulled samples with the agent's counters.

    It is called by two threads: the stream's reader and the counters' reader.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pulled = 0
        # nothing is dropped: a memory of stamps; all are counted
        self._recent: deque[float] = deque(maxlen=_RECENT)
        self._base: int | None = None
        self._before: int | None = None
        self._at_least_before = 0
        # nothing is dropped: a later report has all counts of an earlier one
        self._waiting: deque[_Report] = deque(maxlen=_WAITING)
        self._device = self._transport = 0
        # Losses of outlets that have ended.
        self._earlier = Losses(device=0, transport=0)
        self._is_known = False

    @property
    def losses(self) -> Losses | None:
        """The latest result; None before the agent's first report."""
        if not self._is_known:
            return None
        earlier = self._earlier
        return Losses(earlier.device + self._device, earlier.transport + self._transport)

    @property
    def before(self) -> int | None:
        """Samples that the outlet had sent before this node first connected, None while unknown.

        They are not lost, because no node was receiving. After a restart of the node, they
        give the number of samples between the two nodes.
        """
        return self._before

    def pulled(self, stamps: Sequence[float]) -> None:
        """Count samples; the stamps are on the sender's clock, as in the agent's reports."""
        with self._lock:
            self._pulled += len(stamps)
            self._recent.extend(stamps)
            if self._waiting:
                self._settle()

    def reported(self, pushed: int, lost: int, last_stamp: float) -> None:
        """Add an agent's report about this stream."""
        with self._lock:
            if not pushed:
                self._take_device(lost)
                return  # nothing is dropped: nothing was pushed yet
            self._waiting.append(_Report(pushed, lost, last_stamp))
            self._settle()

    def restarted(self, undelivered: int = 0) -> None:
        """Start again: the stream comes from an outlet that counts from zero.

        Parameters
        ----------
        undelivered
            Samples that the node had received from the previous outlet, and that LSL
            dropped when it ended.
        """
        with self._lock:
            self._waiting.clear()
            self._recent.clear()
            # Samples that the new outlet sends before it is attached are lost, as the node runs.
            self._pulled, self._base = 0, 0
            transport = self._earlier.transport + self._transport + undelivered
            self._earlier = Losses(self._earlier.device, transport)
            self._transport = 0

    def _take_device(self, lost: int) -> None:
        """Add the agent's own count; a smaller one shows that the agent was restarted."""
        if lost < self._device:
            self._earlier = Losses(self._earlier.device + self._device, self._earlier.transport)
        self._device = lost
        self._is_known = True

    def _settle(self) -> None:
        """Compare the reports whose stamp the stream has passed."""
        while self._waiting and self._recent and self._waiting[0].last_stamp <= self._recent[-1]:
            report = self._waiting[0]
            later = self._pulled_after(report.last_stamp)
            missing = report.pushed - (self._pulled - later)
            if not later and not self._is_complete(missing):
                return  # nothing is dropped: it waits for the samples of this report
            self._waiting.popleft()
            if later == _RECENT:
                continue  # nothing is dropped: a later report tells the same
            if self._base is None and later == self._pulled:
                # Reports may come before the stream is attached: samples pushed between
                # this report and the first sample are in no count yet.
                self._at_least_before = report.pushed
                continue  # nothing is dropped: a later report tells the same
            if self._base is None:
                self._base = self._before = missing
            self._transport = missing - self._base
            self._take_device(report.lost)

    def _is_complete(self, missing: int) -> bool:
        """Whether no more samples of the newest stamp can be on their way."""
        if self._base is None:
            return missing <= self._at_least_before
        if not self._is_known:
            return False
        return missing - self._base <= self._transport

    def _pulled_after(self, stamp: float) -> int:
        count = 0
        for recent in reversed(self._recent):
            if recent <= stamp:
                break
            count += 1
        return count


@dataclass(frozen=True, slots=True)
class Lost:
    """Samples of a stream that did not reach the node.

    Attributes
    ----------
    count
        -1 if unknown.
    is_estimated
        Whether it was estimated from stamps, not counted by the agent.
    """

    count: int
    is_estimated: bool

    def __str__(self) -> str:
        if self.count < 0:
            return "unknown"
        return f"about {self.count}" if self.is_estimated else str(self.count)


@dataclass(slots=True)
class Delays:
    """Ages of blocks of samples when the node received them, in seconds."""

    total: float = 0.0
    count: int = 0
    longest: float = 0.0

    def add(self, age_s: float) -> None:
        """Add the age of a block's newest sample."""
        self.total += age_s
        self.count += 1
        self.longest = max(self.longest, age_s)

    @property
    def mean(self) -> float | None:
        """Mean age; None without blocks."""
        return self.total / self.count if self.count else None


@dataclass(slots=True)
class NodeCounters:
    """Counters of one stream in the node; they outlive its bridges."""

    received: int = 0
    missing: int = 0  # Missing samples, estimated from the stamps of a regular stream.
    # Reports of data that was not published unchanged.
    refusals: Refusals = field(default_factory=Refusals)
    undelivered: int = 0  # Samples that LSL dropped with the last connection.
    # Comparison of the agent's counters with the pulled samples.
    comparison: CountersComparison = field(default_factory=CountersComparison)
    delays: Delays = field(default_factory=Delays)  # Delays since the last report.
    # State of the device's clock, by `biosensor_common.ros.messages.CLOCK_FACTS`; only one stream
    # per device has it.
    clock: Mapping[str, float] = field(default_factory=dict[str, float])
    said: AgentSays = field(default_factory=AgentSays)  # What its agent says of it now.

    @property
    def unfit(self) -> int:
        """Samples that do not fit the raw topic's message type and are missing there."""
        return self.refusals.count(Refusal.UNFIT, Refusal.NO_TIME)

    @property
    def unstamped(self) -> int:
        """Samples missing on stamped topics, because the sender's clock offset is unknown."""
        return self.refusals.count(Refusal.UNSTAMPED)

    @property
    def discarded(self) -> int:
        """Samples of incomplete chunks before a gap; they were published on the raw topic."""
        return self.refusals.count(Refusal.CHUNK_CUT)

    def lost(self, *, can_estimate: bool) -> Lost:
        """Return the losses: the agent's count, else an estimate, else unknown."""
        losses = self.comparison.losses
        if losses is not None:
            return Lost(losses.total, is_estimated=False)
        return (
            Lost(self.missing, is_estimated=True) if can_estimate else Lost(-1, is_estimated=False)
        )

    def connection_ended(self, undelivered: int) -> None:
        """Record samples that LSL dropped; for an outlet that continues, its reports count them."""
        self.undelivered = undelivered
        self.missing += undelivered
        if undelivered:
            self.refusals.refuse(Refusal.UNDELIVERED, undelivered)

    def shape_changed(self, name: str, channels: int, kind: ChannelFormat, rate: float) -> None:
        """Report each time that a stream came back in another shape."""
        shape = f"{channels} channels of {kind} at {rate or 'an irregular rate'}"
        self.refusals.over(Refusal.FORMAT_CHANGED, name)
        self.refusals.refuse(Refusal.FORMAT_CHANGED, about=name, shape=shape)

    def outlet_changed(self) -> None:
        """Record that the following samples come from another outlet."""
        self.comparison.restarted(self.undelivered)
        self.undelivered = 0

    def take_delays(self) -> Delays:
        """Return the delays since the last call."""
        delays, self.delays = self.delays, Delays()
        return delays


def can_estimate_losses(header: StreamHeader) -> bool:
    """Whether losses are estimated from gaps between stamps; our streams have the agent's count.

    A replay of our streams has no such count, because no agent sends it.
    """
    return (header.foreign or header.replay is not None) and header.rate > 0
