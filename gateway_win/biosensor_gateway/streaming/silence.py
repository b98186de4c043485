"""Judges which streams of a connected device are silent, and what to do about it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum, unique
from types import MappingProxyType

PATIENCE_S = 5.0
"""How long data that are due may be absent, unless a driver says otherwise."""
PATIENCE_SAMPLES = 20
LARGEST_STEP_S = 1.0
"""A longer time between two looks at the clock means that the agent did not run."""
RETRY_S = 60.0
"""What neither enabling nor a new connection brought back is enabled again so often."""


@unique
class Remedy(Enum):
    """Remedy for silent streams, in the order in which they are tried."""

    ENABLE = "enabling again"
    RECONNECT = "connecting again"
    NONE = "none"
    """Both were tried; the other streams must not suffer any longer."""


@dataclass(frozen=True, slots=True)
class Silence:
    """Streams that are expected and silent."""

    streams: frozenset[str]  # Data names.
    # Time since the last data of the stream that is silent for longest, while the agent ran.
    seconds: float
    remedy: Remedy
    attempts: int = 0  # New connections that did not help.
    why: str = ""  # The reason that the device reports; empty if it reports none.


@dataclass(slots=True)
class _Stream:
    limit_s: float
    heard_s: float
    waited_from_s: float
    is_enabled_again: bool = False
    is_excused: bool = False


def limits(
    rates: Mapping[str, float], due: Mapping[str, float], patience_s: float
) -> dict[str, float]:
    """Return how long each stream may be silent, in seconds.

    Parameters
    ----------
    rates
        Nominal rates in Hz by data name; irregular streams (0) are ignored.
    due
        Limits in seconds of streams that send continuously but irregularly.
    patience_s
        Shortest limit of regular streams.
    """
    # nothing is dropped: these are rates
    regular = {
        name: max(patience_s, PATIENCE_SAMPLES / rate) for name, rate in rates.items() if rate > 0
    }
    return regular | dict(due)


class StreamWatch:
    """Monitors the streams of one device, over all its connections.

    Time passes only while the agent runs: after a sleep of the computer, or of a starved
    agent, buffered data have their full time to arrive.

    Parameters
    ----------
    clock
        Monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._read_s = clock()
        self._now_s = 0.0
        self._streams: dict[str, _Stream] = {}
        self._limit_s = self._patience_s = math.inf
        self._device_s = -math.inf
        self._attempts: dict[str, int] = {}
        self._came_back: set[str] = set()
        self._denied: dict[str, str] = {}
        self._remarks: dict[str, str] = {}

    @property
    def device_silence_s(self) -> float:
        """Seconds since the last valid data from the device."""
        return self._now() - self._device_s

    @property
    def is_device_silent(self) -> bool:
        """Whether the device has sent no valid data at all for too long."""
        return self.device_silence_s >= self._limit_s

    @property
    def absent(self) -> frozenset[str]:
        """Streams that are silent, and did not send again after any remedy."""
        return frozenset(self._attempts)

    @property
    def denied(self) -> Mapping[str, str]:
        """Reasons for which the device denies streams, by data name; these are not expected."""
        return self._denied

    @property
    def remarks(self) -> Mapping[str, str]:
        """Problems with the arriving data, as clauses, by what they are about."""
        return self._remarks

    def remark(self, about: str, text: str) -> None:
        """Set or replace a problem with the arriving data; an empty text clears it."""
        self._remarks.pop(about, None)
        if text:
            self._remarks[about] = text

    @property
    def is_complete(self) -> bool:
        """Whether no stream is missing."""
        return not self._attempts and not self._denied

    @property
    def is_waiting(self) -> bool:
        """Whether a stream was restarted and may still send."""
        return any(each.is_enabled_again for each in self._streams.values())

    def expect(
        self,
        limits_s: Mapping[str, float],
        device_limit_s: float = math.inf,
        denied: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        """Begin with a new connection.

        Parameters
        ----------
        limits_s
            How long each expected stream may be silent.
        device_limit_s
            How long the device may send nothing at all.
        denied
            Reasons for which the device denies streams, by data name. They are expected as soon
            as they send.
        """
        now = self._now()
        self._streams = {name: _Stream(limit, now, now) for name, limit in limits_s.items()}
        self._limit_s = device_limit_s
        self._device_s = now
        # What is not due any more is not missed.
        for name in self._attempts.keys() - (self._streams.keys() - denied.keys()):
            del self._attempts[name]
        self._denied = dict(denied)
        self._remarks.clear()
        for name in denied:
            self._streams.setdefault(name, _Stream(math.inf, now, now)).is_excused = True

    def heard(self, *names: str) -> None:
        """Note valid data from the device, about these streams or in general.

        Data without a value, as without skin contact, count too.
        """
        now = self._device_s = self._now()
        for name in names:
            stream = self._streams.get(name)
            if stream is None:
                continue  # nothing is dropped: this watch does not follow that stream
            stream.heard_s = stream.waited_from_s = now
            stream.is_enabled_again = stream.is_excused = False
            was_denied = self._denied.pop(name, None) is not None
            if self._attempts.pop(name, None) is not None or was_denied:
                self._came_back.add(name)

    def excuse(self, names: Iterable[str]) -> None:
        """Stop monitoring these streams until data arrive again, for a known reason."""
        for name in names:
            if name in self._streams:
                self._streams[name].is_excused = True
                self._streams[name].is_enabled_again = False

    def enabled_again(self, names: Iterable[str]) -> None:
        """Note that a driver has restarted the streams, as `judge` requested.

        Data that arrived meanwhile may be older than the restart.
        """
        now = self._now()
        for name in names:
            if name in self._streams:
                self._streams[name].is_enabled_again = True
                self._streams[name].waited_from_s = now
                self._attempts.setdefault(name, 0)
                self._came_back.discard(name)

    def wait_again(self) -> None:
        """Restart the time limit of every stream."""
        now = self._now()
        for stream in self._streams.values():
            stream.waited_from_s = now

    def take_came_back(self) -> frozenset[str]:
        """Return silent streams that have sent again since the last call."""
        came_back = frozenset(self._came_back)
        # nothing is dropped: they are returned
        self._came_back.clear()
        return came_back

    def judge(self, *, can_enable: bool, patience_s: float = math.inf) -> Silence | None:
        """Return the silent streams and the remedy to try now; None if there is nothing to do.

        Call it several times per second. The remedy is expected to be tried: the next one is
        returned if it did not help.

        Parameters
        ----------
        can_enable
            Whether the driver can restart single streams.
        patience_s
            Upper bound of all time limits.
        """
        self._now()
        self._patience_s = patience_s
        overdue = self._overdue()
        if not overdue:
            return None  # nothing is dropped: no stream is silent
        if can_enable and not all(each.is_enabled_again for each in overdue.values()):
            # What has stopped together is taken together, also where more patience is due.
            together = self._overdue(0.5)
            return self._enable(
                # nothing is dropped: these are names
                {name: each for name, each in together.items() if not each.is_enabled_again}
            )
        if self._may_reconnect(overdue):
            waited_for = {name: e for name, e in self._streams.items() if e.is_enabled_again}
            return self._reconnect(overdue | waited_for)
        return self._leave(overdue)

    def _overdue(self, share: float = 1.0) -> dict[str, _Stream]:
        return {
            name: each
            for name, each in self._streams.items()
            if not each.is_excused
            and self._now_s - each.waited_from_s >= share * min(each.limit_s, self._patience_s)
        }

    def _enable(self, overdue: Mapping[str, _Stream]) -> Silence:
        silence = self._silence(overdue, Remedy.ENABLE)
        self.enabled_again(overdue)
        return silence

    def _may_reconnect(self, overdue: Iterable[str]) -> bool:
        """Whether to reconnect: not tried yet, or nothing to lose because no stream sends."""
        others = {name for name, each in self._streams.items() if not each.is_excused}
        others -= self._attempts.keys() | set(overdue)
        return not others or any(not self._attempts.get(name) for name in overdue)

    def _reconnect(self, overdue: Mapping[str, _Stream]) -> Silence:
        silence = self._silence(overdue, Remedy.RECONNECT)
        for name in overdue:
            self._attempts[name] = self._attempts.get(name, 0) + 1
        return silence

    def _leave(self, overdue: Mapping[str, _Stream]) -> Silence:
        silence = self._silence(overdue, Remedy.NONE)
        for each in overdue.values():
            each.is_enabled_again = False
            each.waited_from_s = self._now_s + RETRY_S
        return silence

    def _silence(self, overdue: Mapping[str, _Stream], remedy: Remedy) -> Silence:
        seconds = max(self._now_s - each.heard_s for each in overdue.values())
        attempts = max(self._attempts.get(name, 0) for name in overdue)
        return Silence(frozenset(overdue), seconds, remedy, attempts)

    def _now(self) -> float:
        read_s = self._clock()
        self._now_s += min(read_s - self._read_s, LARGEST_STEP_S)
        self._read_s = read_s
        return self._now_s
