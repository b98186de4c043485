"""Counts and keeps what was received of one stream, over all its outlets and inlets."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biosensor_common.announcements import decoded
from biosensor_common.quantities import ChannelFormat
from biosensor_common.stream_header import CoreFields
from biosensor_gateway.agent.rate_meter import RateMeter
from biosensor_gateway.page.network.placing import Placer
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
        block
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
