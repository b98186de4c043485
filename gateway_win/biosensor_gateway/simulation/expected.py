"""The facts that an agent can know of a virtual device; the suites of all sensors go by it."""

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
"""What devices of most kinds cannot have, and why."""
NO_INTERVALS = "it tells no intervals between beats"
NO_RATE = "none of its signals has a rate"
ONE_RATE = "each of its signals has one rate, which no setting changes"
TELLS_ITS_RATE = "its rate is asked for or told at each connection"
SAYS_WHAT_IT_IS = "each message comes by a characteristic of its own, which says what it is"


class Contact(NamedTuple):
    """The channel that tells whether the device is worn.

    Attributes
    ----------
    data_name, channel
        The stream, and the channel's column.
    off
        What it holds while the device is not worn.
    """

    data_name: str
    channel: int
    off: float = 0.0


class Gap(Enum):
    """What a device did while it was not connected, as far as a host can know."""

    MEASURED = "measured"
    """All that the gap had room for is lost."""
    STOPPED = "stopped"
    """Nothing is lost but what was on its way."""
    UNKNOWN = "unknown"
    """It stopped at some moment in the gap."""


@dataclass(frozen=True, slots=True)
class LossTolerance:
    """By how many samples an agent's count of those that are lost may be wrong.

    Attributes
    ----------
    always
        By data name, where not even a loss within a connection is counted exactly.
    over_break
        Besides, when the connection broke or the device forgot to send.
    over_restart
        By data name, in place of `over_break` when the device was restarted.
    by_arrival
        Whether what comes first behind a break is placed by when it came: the agent then takes
        what holds a packet up beside the break for a part of it, or for the end of it.
    """

    always: Mapping[str, int] = field(default_factory=dict[str, int])
    over_break: int = 0
    over_restart: Mapping[str, int] = field(default_factory=dict[str, int])
    by_arrival: bool = False

    def of(self, data_name: str, *, is_break: bool, is_restart: bool) -> int:
        """Return so many samples of one stream; a restart is a break, too."""
        over_break = self.over_break if is_break else 0
        if is_restart:
            over_break = self.over_restart.get(data_name, over_break)
        return self.always.get(data_name, 0) + over_break


@dataclass(frozen=True, slots=True)
class Expected:
    """What of a device's state, times and losses arrives, and how well it is known.

    Attributes
    ----------
    contact
        Where it shows whether the device is worn; None = in the channel with the role
        ``CONTACT``.
    without_contact
        Data names that have no value off the body: NaN in its place if they are regular, else
        nothing.
    by_agent
        Data names of what the agent computes, or decides when to send: no truth of the wire.
    unstamped_s
        By data name what the device does not stamp, and how uncertain its time is in seconds,
        besides the delay of the link.
    gaps
        By fault, where the device does not measure all the time that it is not connected.
    loss_tolerance
        How well losses can be counted.
    impossible
        By fault, why the real device cannot have it; what its link makes impossible, the link says.
    deniable
        So many of its signals at least can be refused one by one, if any can.
    bundles_s
        So long may what it sends wait and come together, and its clock is not taken for set.
    is_linked
        Whether a host connects to it; else it is heard, or it is not.
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
