"""Tells what other streams of a device say of one: that somebody moves, or that it is not worn.

An arm that swings moves the blood under a sensor more than the heart does, as regularly: from the
pulse alone the two cannot be told apart. Conductance alone does not tell skin from a wet sleeve.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from biosensor_common.quantities import ContentType
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.features import thresholds as at
from biosensor_gateway.features.heart import HR_QUALITY
from biosensor_gateway.features.quality import REASONS
from biosensor_gateway.features.runs import Array, Event, Hops, Runs
from biosensor_gateway.features.state import BR_STATE, HR_STATE

_PIECES = round(at.MOTION_WINDOW_S / at.MOTION_PIECE_S)


class _Place(NamedTuple):
    """Which channels of a feature tell quality and motion of a window of this length."""

    quality: int
    motion: int
    window_s: float


_HRV_CHANNELS = 4
_TOLD = {
    "sqi": (_Place(0, 1 + len(REASONS), at.MOTION_WINDOW_S),),
    HR_QUALITY: (_Place(3, 4, at.HR_WINDOW_S),),
    HR_STATE: (_Place(2, 3, at.HR_WINDOW_S),),
    BR_STATE: (_Place(2, 3, at.MOTION_WINDOW_S),),
    "hrv_live": tuple(
        _Place(_HRV_CHANNELS * place + 2, _HRV_CHANNELS * place + 3, window_s)
        for place, window_s in enumerate(at.HRV_WINDOWS_S, len(at.HRV_WINDOWS_S))
    ),
}
"""By feature."""


class Witness(Protocol):
    """What another stream of a device says."""

    def take(self, stamps: Array, values: Array) -> None:
        """Take samples in; shapes (n,) and (n, n_channels)."""
        ...

    def knows(self, end_s: float) -> bool:
        """Whether everything up to this stamp has come."""
        ...

    def told(self, event: Event, *, lowers: bool) -> Event:
        """Return the event with what is known of its time.

        `lowers` is whether what moves can be taken for what is measured.
        """
        ...


Witnesses = dict[tuple[DeviceIdentity, str], Witness]
"""By device and LSL content type."""


class _Flags:
    """What was so when, in the order of time; it is remembered for as long as is wanted."""

    def __init__(self, keep_s: float) -> None:
        self._keep_s = keep_s
        self._stamps: list[float] = []
        self._flags: list[bool] = []

    def add(self, stamp: float, flag: bool) -> None:
        if self._stamps and stamp <= self._stamps[-1]:
            # The clock was set back.
            self._stamps.clear()
            self._flags.clear()
        self._stamps.append(stamp)
        self._flags.append(flag)
        # Not with each one, for a list moves up by all that is left.
        if self._stamps[0] < stamp - 2 * self._keep_s:
            old = bisect_right(self._stamps, stamp - self._keep_s)
            del self._stamps[:old], self._flags[:old]

    def between(self, begin_s: float, end_s: float) -> list[bool]:
        """Return those after the begin, up to the end."""
        return self._flags[self._part(begin_s, end_s)]

    def stamps_of(self, begin_s: float, end_s: float) -> list[float]:
        """Return when it was so in between."""
        part = self._part(begin_s, end_s)
        pairs = zip(self._stamps[part], self._flags[part], strict=True)
        return [stamp for stamp, flag in pairs if flag]

    def _part(self, begin_s: float, end_s: float) -> slice:
        return slice(bisect_right(self._stamps, begin_s), bisect_right(self._stamps, end_s))


class Motion:
    """Takes acceleration; tells of spans of time whether there was motion.

    Parameters
    ----------
    rate
        Nominal, in Hz; values are three axes in g.
    foreign
        See `Runs`.
    keep_s
        How long it is remembered.
    """

    def __init__(self, rate: float, *, foreign: bool, keep_s: float = at.MOTION_KEPT_S) -> None:
        hole_s = at.HOLE_S[ContentType.ACCELEROMETER]
        self._runs = Runs(lambda: _Seconds(rate, self._note), rate, hole_s=hole_s, foreign=foreign)
        self._moves, self._is_moving = _Flags(at.MOTION_WINDOW_S), _Flags(keep_s)
        self._latest = -math.inf

    def take(self, stamps: Array, values: Array) -> None:
        """See `Witness`."""
        self._runs.take(stamps, values)
        if len(stamps):
            self._latest = float(stamps[-1])

    def knows(self, end_s: float) -> bool:
        """See `Witness`."""
        return self._latest >= end_s

    def told(self, event: Event, *, lowers: bool) -> Event:
        """See `Witness`: whether there was motion, and less quality of a pulse where there was."""
        values = list(event.values)
        for place in _TOLD[event.feature]:
            moves = self._between(event.stamp - place.window_s, event.stamp)
            values[place.motion] = moves
            if lowers and moves == 1:
                values[place.quality] = min(values[place.quality], at.MOTION_QUALITY)
        return event._replace(values=tuple(values))

    def _between(self, begin_s: float, end_s: float) -> float:
        """Return 1 if there was motion in any `MOTION_WINDOW_S` between them, 0 if not.

        NaN if nothing was measured then.
        """
        earliest = min(begin_s + at.MOTION_WINDOW_S, end_s - 1.5 * at.MOTION_PIECE_S)
        inside = self._is_moving.between(earliest, end_s)
        return float(any(inside)) if inside else math.nan

    def _note(self, end_s: float, moves: bool) -> None:
        self._moves.add(end_s, moves)
        last = self._moves.between(end_s - at.MOTION_WINDOW_S, end_s)[-_PIECES:]
        self._is_moving.add(end_s, sum(last) * at.MOTION_PIECE_S >= at.MOTION_LEAST_S)


class _Seconds:
    """Judges each second of a run by how far the acceleration is from its mean."""

    def __init__(self, rate: float, note: Callable[[float, bool], None]) -> None:
        self._hops = Hops(max(2, round(at.MOTION_PIECE_S * rate)))
        self._note = note

    def take(self, stamps: Array, values: Array) -> list[Event]:
        for times, piece in self._hops.take(stamps, values):
            spread = np.sqrt(np.square(piece - piece.mean(axis=0)).sum(axis=1).mean())
            self._note(float(times[-1]), bool(spread >= at.MOTION_LEAST_G))
        return []  # nothing is dropped: it is kept as motion


class Warmth:
    """Takes the temperature of skin; tells where it is none of skin that a sensor is worn on.

    Rule 3 of Kleckner 2018, and rule 4 of it: what is near is not valid either.

    Parameters
    ----------
    keep_s
        How long it is remembered; values are in degrees Celsius.
    """

    def __init__(self, keep_s: float = at.MOTION_KEPT_S) -> None:
        self._is_out = _Flags(keep_s)
        self._latest = -math.inf

    def take(self, stamps: Array, values: Array) -> None:
        """See `Witness`."""
        low, high = at.SKIN_CELSIUS
        for stamp, value in zip(stamps.tolist(), values[:, 0].tolist(), strict=True):
            if math.isfinite(stamp) and math.isfinite(value):
                self._is_out.add(stamp, not low <= value <= high)
                self._latest = stamp

    def knows(self, end_s: float) -> bool:
        """See `Witness`."""
        return self._latest >= end_s

    def told(self, event: Event, *, lowers: bool) -> Event:
        """See `Witness`: no more quality than the share of its last seconds that is valid."""
        del lowers
        near_s, end_s = at.EDA_INVALID_NEAR_S, event.stamp
        reached = begin_s = end_s - near_s
        invalid_s = 0.0
        for stamp in self._is_out.stamps_of(begin_s - near_s, end_s):
            until = min(end_s, stamp + near_s)
            invalid_s += max(0.0, until - max(reached, stamp - near_s))
            reached = max(reached, until)
        quality = 1 - invalid_s / near_s
        values = list(event.values)
        values[0] = min(values[0], quality)
        if quality < at.GOOD_QUALITY:
            values[1 + REASONS.index("out_of_range")] = 1.0
        return event._replace(values=tuple(values))


_ASKED: dict[str, tuple[str, ...]] = {
    ContentType.GSR: (ContentType.ACCELEROMETER, ContentType.TEMPERATURE),
}
"""Which streams are asked of a type; of others, acceleration."""


class Beside:
    """Has witnesses say what they know of events.

    These wait until everything of their time has come, `LUMP_S` at most.

    Parameters
    ----------
    witnesses
        Of all devices.
    identity
        Of the device that the events are of.
    content_type
        Of the stream that they are of.
    """

    def __init__(self, witnesses: Witnesses, identity: DeviceIdentity, content_type: str) -> None:
        self._witnesses = witnesses
        asked = _ASKED.get(content_type, (ContentType.ACCELEROMETER,))
        self._keys = [(identity, each) for each in asked]
        self._lowers = content_type == ContentType.PPG
        self._waiting: deque[Event] = deque()

    def take(self, events: Sequence[Event], now_s: float) -> list[Event]:
        """Take events in; return those of which it is known by now.

        Parameters
        ----------
        now_s
            The latest stamp of the source.
        """
        there = [self._witnesses[each] for each in self._keys if each in self._witnesses]
        told = [each for each in events if each.feature not in _TOLD]
        self._waiting.extend(each for each in events if each.feature in _TOLD)
        while self._waiting:
            stamp = self._waiting[0].stamp
            knowing = [each for each in there if each.knows(stamp)]
            if len(knowing) < len(there) and stamp > now_s - at.LUMP_S:
                break
            event = self._waiting.popleft()
            for each in knowing:
                event = each.told(event, lowers=self._lowers)
            told.append(event)
        return told

    def finish(self) -> list[Event]:
        """Return what waits, with what is known."""
        return self.take((), math.inf)
