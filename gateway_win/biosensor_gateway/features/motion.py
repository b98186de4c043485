"""Tells whether somebody moves, from the accelerometer of the device that measures.

An arm that swings moves the blood under a sensor more than the heart does, as regularly: from the
pulse alone the two cannot be told apart.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

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


class _Second(NamedTuple):
    end_s: float
    moves: bool
    is_moving: bool


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
        self._runs = Runs(lambda: _Seconds(rate, self._note), rate, foreign=foreign)
        self._kept: deque[_Second] = deque()
        self._keep_s = keep_s
        self._latest = -math.inf

    def take(self, stamps: Array, values: Array) -> None:
        """Take samples in; shapes (n,) and (n, 3)."""
        self._runs.take(stamps, values)
        if len(stamps):
            self._latest = float(stamps[-1])

    def knows(self, end_s: float) -> bool:
        """Whether everything up to this stamp has come."""
        return self._latest >= end_s

    def between(self, begin_s: float, end_s: float) -> float:
        """Return 1 if there was motion in any `MOTION_WINDOW_S` between them, 0 if not.

        NaN if nothing was measured then.
        """
        earliest = min(begin_s + at.MOTION_WINDOW_S, end_s - 1.5 * at.MOTION_PIECE_S)
        inside = [each.is_moving for each in self._kept if earliest < each.end_s <= end_s]
        return float(any(inside)) if inside else math.nan

    def _note(self, end_s: float, moves: bool) -> None:
        if self._kept and end_s <= self._kept[-1].end_s:
            # The clock was set back.
            self._kept.clear()
        begin_s = end_s - at.MOTION_WINDOW_S
        last = itertools.islice(reversed(self._kept), _PIECES - 1)
        count = moves + sum(each.moves for each in last if each.end_s > begin_s)
        is_moving = count * at.MOTION_PIECE_S >= at.MOTION_LEAST_S
        self._kept.append(_Second(end_s, moves, is_moving))
        while self._kept[0].end_s < end_s - self._keep_s:
            self._kept.popleft()


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


Motions = dict[DeviceIdentity, Motion]
"""Of each device that measures acceleration."""


class Beside:
    """Says of events whether there was motion, and lowers the quality of a pulse where there was.

    They wait until acceleration of their time has come, `LUMP_S` at most.

    Parameters
    ----------
    motions
        Of all devices.
    identity
        Of the device that the events are of.
    lowers
        Whether what moves can be taken for what is measured.
    """

    def __init__(self, motions: Motions, identity: DeviceIdentity, *, lowers: bool) -> None:
        self._motions, self._identity, self._lowers = motions, identity, lowers
        self._waiting: deque[Event] = deque()

    def take(self, events: Sequence[Event], now_s: float) -> list[Event]:
        """Take events in; return those of which it is known by now.

        Parameters
        ----------
        now_s
            The latest stamp of the source.
        """
        motion = self._motions.get(self._identity)
        told = [each for each in events if each.feature not in _TOLD]
        self._waiting.extend(each for each in events if each.feature in _TOLD)
        while self._waiting:
            stamp = self._waiting[0].stamp
            if motion is not None and not motion.knows(stamp) and stamp > now_s - at.LUMP_S:
                break
            told.append(self._told(self._waiting.popleft(), motion))
        return told

    def finish(self) -> list[Event]:
        """Return what waits, with what is known."""
        return self.take((), math.inf)

    def _told(self, event: Event, motion: Motion | None) -> Event:
        if motion is None or not motion.knows(event.stamp):
            return event
        values = list(event.values)
        for place in _TOLD[event.feature]:
            moves = motion.between(event.stamp - place.window_s, event.stamp)
            values[place.motion] = moves
            if self._lowers and moves == 1:
                values[place.quality] = min(values[place.quality], at.MOTION_QUALITY)
        return event._replace(values=tuple(values))
