"""Follows the gaps of one device, from the last sample before to the first one after."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

SETTLE_S = 2.0
"""Streams come back one after the other, each with its own count of what is missing."""


@dataclass(slots=True)
class Gap:
    """A time in which samples are missing; LSL times in seconds.

    Attributes
    ----------
    since
        Time of the newest sample before it.
    until
        Time of the first sample after it, None as long as there is none.
    lost
        Missing samples by data name, as far as they are counted.
    """

    since: float
    until: float | None = None
    lost: Counter[str] = field(default_factory=Counter[str])


class GapWatch:
    """Makes gaps of broken connections, and of samples that are missing within one."""

    def __init__(self) -> None:
        self._newest: float | None = None
        self._begin = -math.inf
        self._gap: Gap | None = None
        self._is_interruption = False
        self._is_announced = False
        self._awaited: set[str] = set()
        self._settled_s = math.inf

    def sampled(self, data_name: str, first: float, last: float, now: float) -> None:
        """Note samples of a stream by the times of the first and the last."""
        gap = self._gap
        if gap is not None and (
            gap.until is None if self._is_interruption else data_name in self._awaited
        ):
            self._awaited.discard(data_name)
            if gap.until is None:
                self._settled_s = now + SETTLE_S
            gap.until = max(first, gap.since, gap.until or -math.inf)
        self._newest = last if self._newest is None else max(self._newest, last)

    def lost(self, data_name: str, count: int, since: float) -> None:
        """Note samples that are missing behind the one of `since`."""
        since = max(since, self._begin)
        if self._gap is None:
            self._open(since, is_interruption=False)
        assert self._gap is not None
        if not self._is_announced:
            self._gap.since = min(self._gap.since, since)
        self._gap.lost[data_name] += count
        self._awaited.add(data_name)

    def interrupted(self) -> Iterator[Gap]:
        """Begin a gap at the newest sample, unless nothing ever came; yield what to announce."""
        if self._newest is None or (self._is_interruption and self._is_open):
            return
        yield from self._finished(self._newest)
        self._open(self._newest, is_interruption=True)
        yield from self._begun()

    def tick(self, now: float) -> Iterator[Gap]:
        """Yield a gap when its start is to be announced, and again when its end is."""
        yield from self._begun()
        if not self._is_open and now >= self._settled_s:
            yield from self._finished(now)

    def cut_off(self, at: float) -> Iterator[Gap]:
        """End the gap that there is, if any, because nothing is expected any more."""
        yield from self._finished(at)

    def go_on(self, at: float) -> None:
        """Expect samples again, from then on."""
        self._newest = self._begin = at

    @property
    def _is_open(self) -> bool:
        return self._gap is not None and self._gap.until is None

    def _open(self, since: float, *, is_interruption: bool) -> None:
        self._gap = Gap(since)
        self._is_interruption = is_interruption
        self._is_announced = False
        self._awaited.clear()
        self._settled_s = math.inf

    def _begun(self) -> Iterator[Gap]:
        if self._gap is not None and not self._is_announced:
            self._is_announced = True
            yield Gap(self._gap.since)

    def _finished(self, at: float) -> Iterator[Gap]:
        yield from self._begun()
        gap, self._gap = self._gap, None
        if gap is not None:
            until = max(at, gap.since) if gap.until is None else gap.until
            yield Gap(gap.since, until, gap.lost)
