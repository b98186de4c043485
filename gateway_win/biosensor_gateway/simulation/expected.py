"""The facts that an agent can know about a virtual device, for the tests of all sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType
from typing import NamedTuple

from biosensor_gateway.simulation.faults import FaultKind, Kind, Untidiness

USUALLY_IMPOSSIBLE: Mapping[Kind, str] = MappingProxyType(
    {
        Untidiness.APART: "all channels of a signal come in one message",
        FaultKind.STEP_BACK: "no value of it is made of counts",
    }
)
"""Faults that most kinds of devices cannot have, with reasons."""
NO_INTERVALS = "it tells no intervals between beats"
NO_RATE = "none of its signals has a rate"
ONE_RATE = "each of its signals has one rate, which no setting changes"
TELLS_ITS_RATE = "its rate is asked for or told at each connection"
SAYS_WHAT_IT_IS = "each message comes by a characteristic of its own, which says what it is"


class Contact(NamedTuple):
    """The channel that shows whether the device is worn.

    Attributes
    ----------
    data_name, channel
        The stream, and the channel's column.
    off
        Its value while the device is not worn.
    """

    data_name: str
    channel: int
    off: float = 0.0


class Gap(Enum):
    """What a device did while disconnected, as far as a host can know."""

    MEASURED = "measured"
    """It measured, so all samples in the gap are lost."""
    STOPPED = "stopped"
    """It stopped, so only samples in transit are lost."""
    UNKNOWN = "unknown"
    """It stopped at an unknown time in the gap."""


@dataclass(frozen=True, slots=True)
class LossTolerance:
    """Allowed error of an agent's count of lost samples.

    Attributes
    ----------
    always
        By data name, if even losses within a connection are not counted exactly.
    over_break
        In addition, after a lost connection or a device that stopped sending.
    over_restart
        By data name, instead of `over_break` after a restart of the device.
    by_arrival
        Whether the first packet after a break is placed by its arrival, so that its delay is
        mistaken for a part or the end of the break.
    """

    always: Mapping[str, int] = field(default_factory=dict[str, int])
    over_break: int = 0
    over_restart: Mapping[str, int] = field(default_factory=dict[str, int])
    by_arrival: bool = False

    def of(self, data_name: str, *, is_break: bool, is_restart: bool) -> int:
        """Return the allowed error for one stream; a restart is also a break."""
        over_break = self.over_break if is_break else 0
        if is_restart:
            over_break = self.over_restart.get(data_name, over_break)
        return self.always.get(data_name, 0) + over_break


@dataclass(frozen=True, slots=True)
class Expected:
    """What an agent can know about a device's state, times and losses, and how exactly.

    Attributes
    ----------
    contact
        Channel that shows whether the device is worn; None for the one with the role ``CONTACT``.
    without_contact
        Data names without values off the body: NaN if regular, else no samples.
    by_agent
        Data names that the agent computes or schedules, so they are not in the truth.
    unstamped_s
        Streams without device timestamps, with the uncertainty of their times in seconds, in
        addition to the link's delay.
    gaps
        By fault, if the device does not measure all the time while disconnected.
    loss_tolerance
        Allowed error of counted losses.
    impossible
        By fault, why the real device cannot have it, in addition to those impossible with its
        link.
    deniable
        Minimum number of signals that can be refused one by one, if any.
    bundles_s
        Longest delay of bundled data that is not mistaken for a clock that was set.
    is_linked
        Whether a host connects to it, instead of only receiving it.
    """

    contact: Contact | None = None
    without_contact: tuple[str, ...] = ()
    by_agent: frozenset[str] = frozenset()
    unstamped_s: Mapping[str, float] = field(default_factory=dict[str, float])
    gaps: Mapping[FaultKind, Gap] = field(default_factory=dict[FaultKind, Gap])
    loss_tolerance: LossTolerance = LossTolerance()
    impossible: Mapping[Kind, str] = field(default_factory=dict[Kind, str])
    deniable: int = 2
    bundles_s: float = 3.0
    is_linked: bool = True
