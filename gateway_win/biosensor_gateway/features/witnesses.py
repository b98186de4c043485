"""Corrects features by other streams of the device: motion, and whether the sensor is worn.

A swinging arm moves the blood under a sensor more than the heart does, and as regularly, so that
the pulse alone does not show the difference. Nor does conductance alone show the difference between
skin and a wet sleeve. The stream that shows it is called a witness here.
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
from biosensor_gateway.features import parameters as at
from biosensor_gateway.features.heart import HR_QUALITY
from biosensor_gateway.features.quality import REASONS
from biosensor_gateway.features.runs import BR_STATE, HR_STATE, Array, Event, Hops, Runs

_PIECES = round(at.MOTION_WINDOW_S / at.MOTION_PIECE_S)


class _Place(NamedTuple):
    """The channels of a feature with quality and motion of a window of this length."""

    quality: int
    motion: int
    window_s: float


_HRV_CHANNELS = 4
_PLACES = {
    "sqi": (_Place(0, 1 + len(REASONS), at.MOTION_WINDOW_S),),
    HR_QUALITY: (_Place(3, 4, at.HR_WINDOW_S),),
    HR_STATE: (_Place(2, 3, at.HR_WINDOW_S),),
    BR_STATE: (_Place(2, 3, at.MOTION_WINDOW_S),),
    "hrv_live": tuple(
        _Place(_HRV_CHANNELS * place + 2, _HRV_CHANNELS * place + 3, window_s)
        for place, window_s in enumerate(at.HRV_WINDOWS_S, len(at.HRV_WINDOWS_S))
    ),
}
"""Places by feature."""


class Witness(Protocol):
    """A stream of a device that shows when its other streams are unreliable."""

    def take(self, stamps: Array, values: Array) -> None:
        """Take samples; shapes (n,) and (n, n_channels)."""
        ...

    def knows(self, end_s: float) -> bool:
        """Whether all samples up to this stamp were received."""
        ...

    def corrected(self, event: Event, *, lowers: bool) -> Event:
        """Return the event with its quality or motion at its time.

        `lowers` is whether motion can be mistaken for the measured signal, and lowers its quality.
        """
        ...


Witnesses = dict[tuple[DeviceIdentity, str], Witness]
"""Witnesses by device and LSL content type."""


class _Flags:
    """Stamped flags in the order of time, stored for a limited time."""

    def __init__(self, keep_s: float) -> None:
        self._keep_s = keep_s
        self._stamps: list[float] = []
        self._flags: list[bool] = []

    def add(self, stamp: float, flag: bool) -> None:
        if self._stamps and stamp <= self._stamps[-1]:
            # nothing is dropped: a memory of flags begins again, for the clock was set back
            self._stamps.clear()
            self._flags.clear()
        self._stamps.append(stamp)
        self._flags.append(flag)
        # Not at each call, because deleting from the front of a list moves all the rest.
        if self._stamps[0] < stamp - 2 * self._keep_s:
            old = bisect_right(self._stamps, stamp - self._keep_s)
            # nothing is dropped: nobody asks for older ones
            del self._stamps[:old], self._flags[:old]

    def between(self, begin_s: float, end_s: float) -> list[bool]:
        """Return the flags after the start, up to and including the end."""
        return self._flags[self._part(begin_s, end_s)]

    def stamps_of(self, begin_s: float, end_s: float) -> list[float]:
        """Return the stamps of the flags that are set in between."""
        part = self._part(begin_s, end_s)
        pairs = zip(self._stamps[part], self._flags[part], strict=True)
        # nothing is dropped: it answers when flags were set
        return [stamp for stamp, flag in pairs if flag]

    def _part(self, begin_s: float, end_s: float) -> slice:
        return slice(bisect_right(self._stamps, begin_s), bisect_right(self._stamps, end_s))


class Motion:
    """Witness for motion, from acceleration.

    Parameters
    ----------
    rate
        Nominal rate in Hz; values are three axes in g.
    foreign
        See `Runs`.
    keep_s
        How long motion is stored.
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

    def corrected(self, event: Event, *, lowers: bool) -> Event:
        """See `Witness`: sets motion, and lowers the quality of a pulse during motion."""
        values = list(event.values)
        for place in _PLACES[event.feature]:
            moves = self._between(event.stamp - place.window_s, event.stamp)
            values[place.motion] = moves
            if lowers and moves == 1:
                values[place.quality] = min(values[place.quality], at.MOTION_QUALITY)
        return event._replace(values=tuple(values))

    def _between(self, begin_s: float, end_s: float) -> float:
        """Return 1 if there was motion in any `MOTION_WINDOW_S` in between, 0 if not.

        NaN if there are no measurements.
        """
        earliest = min(begin_s + at.MOTION_WINDOW_S, end_s - 1.5 * at.MOTION_PIECE_S)
        inside = self._is_moving.between(earliest, end_s)
        return float(any(inside)) if inside else math.nan

    def _note(self, end_s: float, moves: bool) -> None:
        self._moves.add(end_s, moves)
        last = self._moves.between(end_s - at.MOTION_WINDOW_S, end_s)[-_PIECES:]
        self._is_moving.add(end_s, sum(last) * at.MOTION_PIECE_S >= at.MOTION_LEAST_S)


class _Seconds:
    """Detects motion in each second of a run, by the RMS distance of acceleration from its mean."""

    def __init__(self, rate: float, note: Callable[[float, bool], None]) -> None:
        self._hops = Hops(max(2, round(at.MOTION_PIECE_S * rate)))
        self._note = note

    def take(self, stamps: Array, values: Array) -> list[Event]:
        for times, piece in self._hops.take(stamps, values):
            spread = np.sqrt(np.square(piece - piece.mean(axis=0)).sum(axis=1).mean())
            self._note(float(times[-1]), bool(spread >= at.MOTION_LEAST_G))
        return []  # nothing is dropped: it is stored as motion


class Warmth:
    """Witness for wear, from skin temperature in degrees Celsius.

    Rule 3 of Kleckner 2018, with rule 4: samples near an invalid one are invalid, too.

    Parameters
    ----------
    keep_s
        How long temperatures are stored.
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

    def corrected(self, event: Event, *, lowers: bool) -> Event:
        """See `Witness`: limits quality to the valid share of the last seconds."""
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
"""Witnesses of a type of stream; of all other types, acceleration."""


class Beside:
    """Corrects the events of a stream by the witnesses of its device.

    Events wait until the witnesses have samples of their time, at most for `LUMP_S`.

    Parameters
    ----------
    witnesses
        Of all devices.
    identity
        Of the events' device.
    content_type
        Of the events' stream.
    """

    def __init__(self, witnesses: Witnesses, identity: DeviceIdentity, content_type: str) -> None:
        self._witnesses = witnesses
        asked = _ASKED.get(content_type, (ContentType.ACCELEROMETER,))
        self._keys = [(identity, each) for each in asked]
        self._lowers = content_type == ContentType.PPG
        self._waiting: deque[Event] = deque()

    def take(self, events: Sequence[Event], now_s: float) -> list[Event]:
        """Take events; return those that are corrected or need no correction.

        Parameters
        ----------
        now_s
            The latest stamp of the source.
        """
        there = [self._witnesses[each] for each in self._keys if each in self._witnesses]
        # nothing is dropped: the others wait
        ready = [each for each in events if each.feature not in _PLACES]
        # nothing is dropped: the others are ready
        self._waiting.extend(each for each in events if each.feature in _PLACES)
        while self._waiting:
            stamp = self._waiting[0].stamp
            knowing = [each for each in there if each.knows(stamp)]
            if len(knowing) < len(there) and stamp > now_s - at.LUMP_S:
                break
            event = self._waiting.popleft()
            for each in knowing:
                event = each.corrected(event, lowers=self._lowers)
            ready.append(event)
        return ready

    def finish(self) -> list[Event]:
        """Return the waiting events, corrected as far as possible."""
        return self.take((), math.inf)
