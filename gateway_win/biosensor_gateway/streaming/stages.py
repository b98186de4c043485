"""Suppresses samples that were measured during a pause, and impossible values; finds flat signals.

A pause is a participant's withdrawal. So the time at which a sample was *measured* decides, not
the time at which it is processed: samples that are still queued when the pause ends are suppressed
as well.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from biosensor_common.quantities import CONSTANT_S, ContentType, Unit
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.spec import SensorSpec, StreamSpec
from biosensor_gateway.streaming.counters import Counters
from biosensor_gateway.system.device_log import DeviceLog, Once

RESUME_GUARD_S = 1.0
"""A stamp is later than the measurement, by the smallest delay of the device and its radio.

That delay is unknown and well below this, so what is stamped later was measured later.
"""
_REMEMBERED_PAUSES = 64


class PauseGate:
    """Decides by its stamp whether a sample may be sent; all times are LSL times in seconds."""

    def __init__(self) -> None:
        self._send_from = -math.inf
        self._began = math.nan
        # Unix time of the pause's start in s, for display; None without a pause.
        self.since: float | None = None
        # nothing is dropped: these are times
        self._pauses: deque[tuple[float, float]] = deque(maxlen=_REMEMBERED_PAUSES)

    @property
    def is_on(self) -> bool:
        """Whether the device is paused now."""
        return self._send_from == math.inf

    @property
    def send_from(self) -> float:
        """Samples measured before this time are not sent; infinite during a pause."""
        return self._send_from

    def begin(self, now: float, since: float | None = None) -> None:
        """Begin a pause; no effect during a pause.

        Parameters
        ----------
        since
            Unix time of the request in s, if it was earlier.
        """
        if not self.is_on:
            self.since = time.time() if since is None else since
            self._began = now
            self._send_from = math.inf

    def end(self, now: float) -> None:
        """End the pause, if there is one."""
        if self.is_on:
            self.since = None
            self._send_from = now + RESUME_GUARD_S
            self._pauses.append((self._began, self._send_from))

    def may_send(self, stamps: Sequence[float]) -> list[bool]:
        """Return for each stamp whether a sample measured then may be sent."""
        if self._send_from == math.inf:
            return [False] * len(stamps)
        # A stamp that is not a number is refused and reported elsewhere.
        return [not stamp < self._send_from for stamp in stamps]

    def share(self, begin: float, end: float) -> float:
        """Return the part of a period that was paused, 0 to 1."""
        ongoing = [(self._began, end)] if self.is_on else []
        if not end > begin:
            return float(any(since <= end <= until for since, until in (*self._pauses, *ongoing)))
        paused_s = sum(
            max(0.0, min(end, until) - max(begin, since))
            for since, until in (*self._pauses, *ongoing)
        )
        return min(1.0, paused_s / (end - begin))


AHEAD_LIMIT_S = 5.0
"""Beats that arrive late have had their time; so far ahead of it are only those told twice."""
ALIKE_LIMIT = 0.3
"""Part of it that is enough where beats that begin before the newest ended have its length."""
_LEAST_ALIKE = 2
_REMEMBERED = 4
_OVERLAP = 0.3
MOST_AHEAD_S, MOST_BEHIND_S = 15.0, 60.0
RIGHT_AGAIN_S, RIGHT_WITHIN_S = 60.0, 1.0
"""Beats are believed again after so long without more of them than time."""
_TOLD_TWICE = (
    "intervals between beats add up to more than the time that has passed, so some were reported "
    "twice"
)

_SENT_TWICE = "; {} reported twice before were sent"


_PARTS = 4
"""A gap of this part of the time for which a value may stay interrupts it."""


class _Checked(NamedTuple):
    """Samples after the check."""

    # samples, times: to be sent.
    samples: ArrayLike
    times: Sequence[float]
    refused: int = 0  # Number of samples of which at least one value was suppressed.
    # A clause with the value and the limit that it exceeds; empty if nothing is wrong.
    why: str = ""
    what: str = ""  # The channel, if it is a single one.


class Plausibility:
    """Suppresses impossible values of one device."""

    def __init__(self, spec: SensorSpec, log: DeviceLog) -> None:
        self._log = log
        self._is_new = Once()
        self._bounds = {
            stream.data_name: _Bounds(stream)
            for stream in spec.streams
            if any(channel.bounds is not None for channel in stream.channels)
        }

    def believed(
        self,
        data_name: str,
        samples: ArrayLike,
        times: Sequence[float],
        counters: Counters,
        refusals: Refusals,
    ) -> tuple[ArrayLike, Sequence[float]]:
        """Return the samples that may be sent; the others are counted, and logged once."""
        bounds = self._bounds.get(data_name)
        if bounds is None:
            return samples, times
        checked = bounds.check(samples, times)
        if checked.why:
            counters.refused += checked.refused
            refusals.refuse(Refusal.IMPLAUSIBLE, checked.refused, why=checked.why)
            if self._is_new(data_name, checked.what):
                # nothing is dropped: it was reported above
                self._log.warning("values are not sent", data=data_name, cause=checked.why)
        return checked.samples, checked.times


class _Bounds:
    """The bounds of one stream's values, and how fast its beats may follow each other."""

    def __init__(self, stream: StreamSpec) -> None:
        self._width = len(stream.channels)
        self._stream = stream
        bounds = [channel.bounds or (-np.inf, np.inf) for channel in stream.channels]
        self._low, self._high = np.array(bounds, np.float64).T
        is_intervals = stream.content_type is ContentType.RR
        in_seconds = stream.channels[0].unit == Unit.SECONDS
        self._beats = _Beats() if is_intervals and in_seconds else None

    def check(self, samples: ArrayLike, times: Sequence[float]) -> _Checked:
        """Replace values outside the bounds by NaN; remove samples without any other value."""
        checked = _Checked(samples, times)
        values = np.asarray(samples, np.float64)
        # Samples that do not fit their times are refused later on.
        if not len(times) or values.shape[:1] != (len(times),):
            return checked
        if values.size != len(times) * self._width:
            return checked
        rows = values.reshape(len(times), self._width)
        beats = self._beats
        if beats is not None and beats.are_ahead(rows[:, 0].tolist(), times):
            return _Checked((), (), len(times), beats.why)
        outside = (rows < self._low) | (rows > self._high)
        if not outside.any():
            return checked
        row, column = (int(each) for each in np.argwhere(outside)[-1])
        left = np.where(outside, np.nan, rows)
        is_kept = ~outside.any(axis=1)
        if self._stream.format.is_float:
            # A regular stream keeps its pace.
            is_kept = is_kept | self._stream.is_regular | ~np.isnan(left).all(axis=1)
        # nothing is dropped: the answer counts them, and says why
        times = [time for time, kept in zip(checked.times, is_kept, strict=True) if kept]
        why = self._sentence(column, float(rows[row, column]))
        what = self._stream.channels[column].label
        return _Checked(left[is_kept], times, int(outside.any(axis=1).sum()), why, what)

    def _sentence(self, column: int, value: float) -> str:
        channel = self._stream.channels[column]
        return (
            f"{channel.label} was {value:g} {channel.unit}, which is not between "
            f"{self._low[column]:g} and {self._high[column]:g}"
        )


class Constants:
    """Reports channels of one device that have one value for longer than a body's signal can."""

    def __init__(self, spec: SensorSpec) -> None:
        self._streams = {
            each.data_name: _Constant(each, CONSTANT_S[each.content_type])
            for each in spec.streams
            if each.content_type in CONSTANT_S and each.is_regular
        }

    def note(
        self, data_name: str, samples: ArrayLike, stamps: Sequence[float], refusals: Refusals
    ) -> None:
        """Process sent samples, at least one."""
        if (stream := self._streams.get(data_name)) is not None:
            rows = np.asarray(samples, np.float64).reshape(len(stamps), -1)
            stream.note(rows, stamps[0], stamps[-1], refusals)

    def restart(self) -> None:
        """Begin again, at a new connection."""
        for stream in self._streams.values():
            stream.restart()

    def look(self, now: float) -> None:
        """Report nothing more of streams that do not send at this LSL time."""
        for stream in self._streams.values():
            stream.look(now)


class _Constant:
    """The channels of one stream; *limit_s* is how long one may have the same value."""

    def __init__(self, stream: StreamSpec, limit_s: float) -> None:
        self._stream, self._limit_s = stream, limit_s
        self._may_rest = np.array([each.may_rest for each in stream.channels])
        self._told = ""
        self._refusals: Refusals | None = None
        self.restart()

    def restart(self) -> None:
        self._values = np.full(len(self._may_rest), np.nan)
        self._since_s = np.full(len(self._may_rest), np.inf)
        self._newest_s = np.inf

    def look(self, now: float) -> None:
        if self._told and self._refusals and now - self._newest_s > self._limit_s / 2:
            self._told = ""
            self._refusals.over(Refusal.FLAT)

    def note(self, rows: NDArray[np.float64], first_s: float, last_s: float, to: Refusals) -> None:
        """Process a block of samples, shape [samples, channels], with its first and last stamp."""
        # NaN is not a value and is ignored.
        if len(rows) == 1:
            low = high = rows[0].copy()
        else:
            low, high = np.fmin.reduce(rows), np.fmax.reduce(rows)
        is_same = (np.isnan(low) | ((low == high) & (low == self._values))) & (
            first_s - self._newest_s < self._limit_s / _PARTS
        )
        self._newest_s = last_s
        if not self._told and not is_same.any():
            # As in nearly every block.
            self._since_s.fill(last_s)
            self._values = np.where(low == high, low, np.nan)
            return  # nothing is dropped: all is well
        self._since_s = np.where(is_same, self._since_s, last_s)
        self._values = np.where(is_same, self._values, np.where(low == high, low, np.nan))
        flat = ~self._may_rest & (last_s - self._since_s >= self._limit_s)
        if not flat.any() and not self._told:
            return  # nothing is dropped: all is well
        told = self._sentence(np.flatnonzero(flat).tolist())
        if told != self._told:
            self._told, self._refusals = told, to
            to.hold(Refusal.FLAT, bool(told), channels=told, limit_s=self._limit_s)

    def _sentence(self, flat: Sequence[int]) -> str:
        named = [
            f"{each.label} ({self._values[column]:g} {each.unit})"
            for column, each in enumerate(self._stream.channels)
            if column in flat
        ]
        return f"{', '.join(named)} {'has' if len(named) == 1 else 'have'}" if named else ""


class _Beats:
    """Compares the sum of a stream's intervals with the time that has passed, by its stamps."""

    def __init__(self) -> None:
        self._ahead_s = 0.0
        self._newest_s: float | None = None
        # Those told last, and how many were like one of them and of a time before the newest.
        self._last: deque[float] = deque(maxlen=_REMEMBERED)  # nothing is dropped: a memory
        self._alike = self._sent_twice = 0
        self._is_noticed = False
        self._told_since_s = self._passed_since_s = 0.0

    @property
    def why(self) -> str:
        """The problem, if the intervals are ahead, as a clause."""
        before = _SENT_TWICE.format(self._sent_twice) if self._sent_twice else ""
        return f"{_TOLD_TWICE}{before}"

    def are_ahead(self, intervals: Sequence[float], times: Sequence[float]) -> bool:
        """Add intervals; return whether their sum exceeds the time that has passed.

        The first ones may be older. Time without intervals counts for a while, because delayed
        ones may arrive.
        """
        before_s = self._newest_s
        alike = self._count_alike(intervals, times)
        self._alike += alike
        newest_s = max(times)
        if before_s is None:
            self._newest_s = newest_s
            return False
        self._newest_s = max(before_s, newest_s)
        passed_s = self._newest_s - before_s
        ahead_s = max(self._ahead_s + float(np.nansum(intervals)) - passed_s, -MOST_BEHIND_S)
        self._ahead_s = min(ahead_s, MOST_AHEAD_S)
        if ahead_s <= 0 or self._are_right_again(float(np.nansum(intervals)), passed_s):
            ahead_s = self._ahead_s = min(0.0, ahead_s)
            self._alike, self._is_noticed = 0, False
        if ahead_s <= AHEAD_LIMIT_S * (ALIKE_LIMIT if self._alike >= _LEAST_ALIKE else 1.0):
            return False
        self._sent_twice += 0 if self._is_noticed else self._alike - alike
        self._is_noticed = True
        return True

    def _are_right_again(self, told_s: float, passed_s: float) -> bool:
        """Whether the time since has caught up with the excess intervals."""
        if not self._is_noticed:
            self._told_since_s = self._passed_since_s = 0.0
            return False
        self._told_since_s += told_s
        self._passed_since_s += passed_s
        if self._passed_since_s < RIGHT_AGAIN_S:
            return False
        ahead_s = self._told_since_s - self._passed_since_s
        self._told_since_s = self._passed_since_s = 0.0
        return ahead_s <= RIGHT_WITHIN_S

    def _count_alike(self, intervals: Sequence[float], times: Sequence[float]) -> int:
        """Return how many equal an earlier interval and begin before the newest one ended."""
        count, newest_s = 0, -np.inf if self._newest_s is None else self._newest_s
        for interval_s, time_s in zip(intervals, times, strict=True):
            overlap_s = newest_s - (time_s - interval_s)
            count += interval_s in self._last and overlap_s > _OVERLAP * interval_s
            newest_s = max(newest_s, time_s)
            self._last.append(interval_s)
        return count
