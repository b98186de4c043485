"""Counts what became of one stream's samples, over all its connections."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from biosensor_common.quantities import ChannelFormat
from biosensor_common.refusal import Refusal
from biosensor_common.refusals import Refusals
from biosensor_common.stream_header import StreamHeader
from lsl_to_ros.statistics.losses import CountersComparison


@dataclass(frozen=True, slots=True)
class Lost:
    """Samples of a stream that did not reach the node.

    Attributes
    ----------
    count
        -1 if nobody can know.
    is_estimated
        From stamps, not from the agent's count.
    """

    count: int
    is_estimated: bool

    def __str__(self) -> str:
        if self.count < 0:
            return "unknown"
        return f"about {self.count}" if self.is_estimated else str(self.count)


@dataclass(slots=True)
class Delays:
    """Ages of blocks of samples when the node got them, in seconds."""

    total: float = 0.0
    count: int = 0
    longest: float = 0.0

    def add(self, age_s: float) -> None:
        """Take in the age of a block's newest sample."""
        self.total += age_s
        self.count += 1
        self.longest = max(self.longest, age_s)

    @property
    def mean(self) -> float | None:
        """None if there was no block."""
        return self.total / self.count if self.count else None


@dataclass(slots=True)
class NodeCounters:
    """Counters of one stream in the node; they outlive its bridges.

    Attributes
    ----------
    received
        Samples received.
    missing
        Samples that did not come, estimated from the stamps of a regular stream.
    refusals
        What was not published as it came.
    undelivered
        Samples that LSL dropped with the last connection.
    comparison
        Of the agent's counters with what was pulled.
    delays
        Since the last report.
    clock
        State of the device's clock, by the `CLOCK_FACTS` of `biosensor_common.topic_text`; of one
        stream of each device.
    """

    received: int = 0
    missing: int = 0
    refusals: Refusals = field(default_factory=Refusals)
    undelivered: int = 0
    comparison: CountersComparison = field(default_factory=CountersComparison)
    delays: Delays = field(default_factory=Delays)
    clock: Mapping[str, float] = field(default_factory=dict[str, float])

    @property
    def unfit(self) -> int:
        """Samples that do not fit a message type, and were not published there."""
        return self.refusals.count(Refusal.UNFIT, Refusal.NO_TIME)

    @property
    def unstamped(self) -> int:
        """Samples that no stamped topic got, because the sender's clock stayed unknown."""
        return self.refusals.count(Refusal.UNSTAMPED)

    @property
    def discarded(self) -> int:
        """Samples of partial chunks that ended at a gap; they went out raw."""
        return self.refusals.count(Refusal.CHUNK_CUT)

    def lost(self, *, can_estimate: bool) -> Lost:
        """By the agent's count, else by an estimate, else unknown."""
        losses = self.comparison.losses
        if losses is not None:
            return Lost(losses.total, is_estimated=False)
        return (
            Lost(self.missing, is_estimated=True) if can_estimate else Lost(-1, is_estimated=False)
        )

    def connection_ended(self, undelivered: int) -> None:
        """Take note of what LSL dropped; an outlet that continues reports it itself."""
        self.undelivered = undelivered
        self.missing += undelivered
        if undelivered:
            self.refusals.refuse(Refusal.UNDELIVERED, undelivered)

    def shape_changed(self, name: str, channels: int, kind: ChannelFormat, rate: float) -> None:
        """Report that a stream came back in another shape; each time, however soon."""
        shape = f"{channels} channels of {kind} at {rate or 'an irregular rate'}"
        self.refusals.over(Refusal.FORMAT_CHANGED, name)
        self.refusals.refuse(Refusal.FORMAT_CHANGED, about=name, shape=shape)

    def outlet_changed(self) -> None:
        """Take note that the samples to come are another outlet's."""
        self.comparison.restarted(self.undelivered)
        self.undelivered = 0

    def take_delays(self) -> Delays:
        """Return the delays since the last call."""
        delays, self.delays = self.delays, Delays()
        return delays


def can_estimate_losses(header: StreamHeader) -> bool:
    """Whether gaps of the stamps tell of losses; our own streams have the agent's count.

    A replay has none: it is sent by a program that measures nothing.
    """
    return (header.foreign or header.replay is not None) and header.rate > 0
