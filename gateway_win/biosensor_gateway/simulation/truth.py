"""Records what a virtual device measured, and which facts an agent can know of it.

Tests compare both with what arrived; the suites of all sensors go by the facts.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from threading import Lock
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.simulation.faults import FaultKind, Kind, Untidiness


class Samples(NamedTuple):
    """Samples of one stream.

    Attributes
    ----------
    times : ndarray of float64, shape (n,)
        LSL time of measurement, without the device's drift.
    values : ndarray of float64, shape (n, channels)
        In declared units, with the precision of the sent format.
    """

    times: NDArray[np.float64]
    values: NDArray[np.float64]


class Truth:
    """The samples that a device has sent, by data name.

    Parameters
    ----------
    kept
        Maximum number of samples kept per stream; None for all, which is only for short tests.
    """

    def __init__(self, kept: int | None = None) -> None:
        self._kept = kept
        self._sent: dict[str, deque[tuple[float, tuple[float, ...]]]] = {}
        self._states: dict[str, Sequence[Sequence[float]]] = {}
        self._unsent: dict[str, int] = {}
        self._lock = Lock()

    def sent(
        self, data_name: str, times: Sequence[float], values: Sequence[Sequence[float]]
    ) -> None:
        """Record samples that were sent."""
        with self._lock:
            known = self._sent.setdefault(data_name, deque(maxlen=self._kept))
            known.extend((time, tuple(row)) for time, row in zip(times, values, strict=True))

    def told(
        self, data_name: str, times: Sequence[float], values: Sequence[Sequence[float]]
    ) -> None:
        """Record a sent state, if it has changed.

        Some devices repeat their state; only changes matter.
        """
        if values != self._states.get(data_name):
            self._states[data_name] = values
            self.sent(data_name, times, values)

    def unsent(self, data_name: str, count: int) -> None:
        """Count samples that were measured while streaming but not sent."""
        with self._lock:
            self._unsent[data_name] = self._unsent.get(data_name, 0) + count

    def samples(self, data_name: str) -> Samples:
        """Return the sent samples, oldest first."""
        with self._lock:
            rows = list(self._sent.get(data_name, ()))
        width = len(rows[0][1]) if rows else 0
        values = np.array([row for _, row in rows], np.float64).reshape(len(rows), width)
        return Samples(np.array([time for time, _ in rows], np.float64), values)

    def unsent_count(self, data_name: str) -> int:
        """Return the number of samples measured but never sent."""
        with self._lock:
            return self._unsent.get(data_name, 0)

    @property
    def data_names(self) -> tuple[str, ...]:
        """Data names of streams with any samples."""
        with self._lock:
            return tuple(self._sent)


USUALLY_IMPOSSIBLE: Mapping[Kind, str] = MappingProxyType(
    {
        Untidiness.APART: "all channels of a signal come in one message",
        Untidiness.PACE: "its sensors run on the clock that it reports: a fast clock drifts",
        FaultKind.STEP_BACK: "none of its values is computed from counters",
    }
)
"""Faults that most kinds of devices cannot have, with reasons."""
NO_INTERVALS = "it reports no intervals between beats"
NO_RATE = "none of its signals has a rate"
ONE_RATE = "each of its signals has one rate, which no setting changes"
TELLS_ITS_RATE = "its rate is requested or reported at each connection"
SAYS_WHAT_IT_IS = "each message comes from its own characteristic, which identifies it"


class Contact(NamedTuple):
    """The channel that shows whether the device is worn."""

    # data_name, channel: the stream, and the channel's column.
    data_name: str
    channel: int
    off: float = 0.0  # Its value while the device is not worn.


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
    """Allowed error of an agent's count of lost samples."""

    # By data name, if even losses within a connection are not counted exactly.
    always: Mapping[str, int] = field(default_factory=dict[str, int])
    over_break: int = 0  # In addition, after a lost connection or a device that stopped sending.
    # By data name, instead of `over_break` after a restart of the device.
    over_restart: Mapping[str, int] = field(default_factory=dict[str, int])
    # Whether the first packet after a break is placed by its arrival, so that its delay is mistaken
    # for a part or the end of the break.
    by_arrival: bool = False

    def of(self, data_name: str, *, is_break: bool, is_restart: bool) -> int:
        """Return the allowed error for one stream; a restart is also a break."""
        over_break = self.over_break if is_break else 0
        if is_restart:
            over_break = self.over_restart.get(data_name, over_break)
        return self.always.get(data_name, 0) + over_break


@dataclass(frozen=True, slots=True)
class Expected:
    """What an agent can know about a device's state, times and losses, and how exactly."""

    # Channel that shows whether the device is worn; None for the one with the role `CONTACT`.
    contact: Contact | None = None
    # Data names without values off the body: NaN if regular, else no samples.
    without_contact: tuple[str, ...] = ()
    # Data names that the agent computes or schedules, so they are not in the truth.
    by_agent: frozenset[str] = frozenset()
    # Streams without device timestamps, with the uncertainty of their times in seconds, in addition
    # to the link's delay.
    unstamped_s: Mapping[str, float] = field(default_factory=dict[str, float])
    # By fault, if the device does not measure all the time while disconnected.
    gaps: Mapping[FaultKind, Gap] = field(default_factory=dict[FaultKind, Gap])
    loss_tolerance: LossTolerance = LossTolerance()  # Allowed error of counted losses.
    # By fault, why the real device cannot have it, in addition to those impossible with its link.
    impossible: Mapping[Kind, str] = field(default_factory=dict[Kind, str])
    deniable: int = 2  # Minimum number of signals that can be refused one by one, if any.
    # Longest delay of bundled data that is not mistaken for a clock that was set.
    bundles_s: float = 3.0
    is_linked: bool = True  # Whether a host connects to it, instead of only receiving it.
