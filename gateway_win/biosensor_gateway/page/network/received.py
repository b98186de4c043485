"""Counts and keeps what was received of one stream, over all its outlets and inlets."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biosensor_common.lsl.header import decoded
from biosensor_common.quantities import ChannelFormat
from biosensor_common.stream_header import CoreFields
from biosensor_gateway.agent.rate_meter import RateMeter
from biosensor_gateway.page.network.receiver import Block

TEXTS_KEPT = 8
MAX_TEXT = 4000
"""More than is shown: an agent's entries are JSON."""
MAX_COUNTERS = 1_000_000
_TEXT_CHANNELS = 8
_GAP_PERIODS = 1.5
# Other programs often stamp with the time at which they push, so their stamps jitter.
_JITTER_S = 0.1
_MOST_MISSING = 1_000_000_000
LATEST_S, EARLIEST_S = 1.0, 60.0
"""A stamp so far ahead of the arrival, or so far behind it, is of another clock.

Not one of ours: a battery's level waits for its first receiver, with its own stamp.
"""
_DRIFT_S = 2.0

Times = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Entry:
    """One sample of text, with its local LSL time."""

    text: str
    time_s: float


class Received:
    """Counts samples, and keeps the newest.

    Parameters
    ----------
    core
        What the stream announces of itself.

    Attributes
    ----------
    count
        Samples that came.
    missing
        Samples that the stamps show as missing between those; an estimate.
    newest_s
        Local LSL time of the newest sample of this inlet; None before the first.
    heard_s
        Local LSL time at which that came; None before the first.
    values : shape (n_channels,)
        The newest sample; empty for text.
    texts
        The newest entries of a stream of text, the newest last.
    raw
        The newest sample of text as a whole.
    """

    def __init__(self, core: CoreFields) -> None:
        self.count = self.missing = 0
        # nothing is dropped: the page shows the newest only
        self.texts: deque[Entry] = deque(maxlen=TEXTS_KEPT)
        self.begin(core)

    def begin(self, core: CoreFields, *, is_ours: bool = False) -> None:
        """Take note that another inlet follows: what came between is unknown."""
        self.newest_s: float | None = None
        self.heard_s: float | None = None
        self.values: NDArray[np.float64] = np.empty(0)
        self.raw = b""
        self.placer = Placer(is_ours=is_ours)
        self.meter = RateMeter()
        self._is_text = core.format is ChannelFormat.STRING
        self._rate = core.rate
        self._last_stamp: float | None = None

    def age_s(self, now: float) -> float | None:
        """Return how old the newest sample is; None if there is none."""
        return None if self.newest_s is None else max(0.0, now - self.newest_s)

    def take(self, block: Block, now: float) -> NDArray[np.float64]:
        """Take in samples; return their local LSL times.

        Parameters
        ----------
        now
            Local LSL time.
        """
        times = self.placer.place(block.stamps, now)
        self._find_gaps(block.stamps)
        self.count += len(times)
        self.newest_s, self.heard_s = float(times[-1]), now
        self.meter.note(self.count, self.newest_s)
        if self._is_text:
            rows = zip(block.samples[-TEXTS_KEPT:], times[-TEXTS_KEPT:], strict=True)
            self.texts.extend(Entry(_text(row), float(time)) for row, time in rows)
            self.raw = block.samples[-1][0][: MAX_COUNTERS + 1]
        else:
            self.values = block.samples[-1].astype(np.float64)
        return times

    def _find_gaps(self, stamps: NDArray[np.float64]) -> None:
        finite = stamps[np.isfinite(stamps)]
        if not self._rate or not len(finite):
            return  # nothing is dropped: there is nothing to find
        before, self._last_stamp = self._last_stamp, float(finite[-1])
        with np.errstate(over="ignore"):
            steps = np.diff(finite, prepend=finite[0] if before is None else before)
        longest = max(_GAP_PERIODS / self._rate, _JITTER_S)
        for step in steps[(steps > longest) & np.isfinite(steps)]:
            self.missing += math.floor(min(step * self._rate, _MOST_MISSING) + 0.5) - 1


def _text(row: NDArray[Any]) -> str:
    parts = (decoded(each[: 4 * MAX_TEXT]) for each in row[:_TEXT_CHANNELS])
    return ", ".join(parts)[:MAX_TEXT]


class Placer:
    """Places the samples of one stream in time.

    Parameters
    ----------
    is_ours
        Whether an agent of ours stamps them.

    Stamps are those of the sender's LSL clock, corrected by what was measured of that. Without a
    measurement, or where a program stamps by another clock (Unix time for instance), the
    earliest arrival tells where they belong.

    Attributes
    ----------
    correction
        Seconds to add to a stamp; None before the first measurement.
    is_by_arrival
        Whether the newest samples were placed by their arrival.
    """

    def __init__(self, *, is_ours: bool = False) -> None:
        self._earliest_s = np.inf if is_ours else EARLIEST_S
        self.correction: float | None = None
        self.is_by_arrival = False
        self._shift_s: float | None = None
        self._last_s = -np.inf

    def place(self, stamps: Times, now: float) -> Times:
        """Return when samples were measured, in local LSL time; it never runs back.

        Parameters
        ----------
        stamps : shape (n,)
            As they came, anything; n > 0.
        now
            Local LSL time.
        """
        times = stamps if self.correction is None else stamps + self.correction
        self.is_by_arrival = self.correction is None or not self._is_plausible(times, now)
        if self.is_by_arrival:
            times = self._by_arrival(stamps, now)
        if self._last_s > now + LATEST_S:
            self._last_s = -np.inf
        times = np.maximum.accumulate(np.maximum(times, self._last_s))
        self._last_s = float(times[-1])
        return times

    def _by_arrival(self, stamps: Times, now: float) -> Times:
        newest = float(stamps[-1])
        if not np.isfinite(stamps).all() or abs(newest) > 1e15:
            return np.full(len(stamps), now)
        shift = now - newest
        is_new = self._shift_s is None or not 0 <= shift - self._shift_s < _DRIFT_S
        self._shift_s = shift if is_new else self._shift_s
        assert self._shift_s is not None
        return np.clip(stamps + self._shift_s, now - EARLIEST_S, now + LATEST_S)

    def _is_plausible(self, times: Times, now: float) -> bool:
        # Comparisons with NaN are false.
        return bool((times < now + LATEST_S).all() and (times > now - self._earliest_s).all())
