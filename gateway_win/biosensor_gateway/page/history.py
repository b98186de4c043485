"""Keeps what came last of every stream; see `bins` for what a screen can show of it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterator

from biosensor_gateway.agent.feed_frames import Samples
from biosensor_gateway.agent.rate_meter import STALE_AFTER_S

KEPT_S = 60.0
HOLDS_S = 30.0
"""How long a heart rate or another value of a body is of now that comes when it comes."""


def is_of_now(age_s: float | None, *, is_regular: bool, is_signal: bool) -> bool:
    """Whether the newest sample of a stream that goes on is that of now.

    Parameters
    ----------
    age_s
        Of the sample; None if there is none.
    is_regular
        Whether the stream has a rate.
    is_signal
        Whether it tells of a body. What it tells of the device itself holds until it changes.
    """
    if age_s is None:
        return False
    if is_regular:
        return age_s < STALE_AFTER_S
    return not is_signal or age_s < HOLDS_S


class History:
    """What came last, by source_id.

    Parameters
    ----------
    kept_s
        For how long it is kept.
    """

    def __init__(self, kept_s: float = KEPT_S) -> None:
        self._kept_s = kept_s
        self._chunks: dict[str, deque[Samples]] = {}

    def add(self, samples: Samples) -> None:
        """Keep what has come; forget what is too old."""
        if not len(samples.stamps):
            return
        kept = self._chunks.setdefault(samples.source_id, deque())
        if kept and kept[-1].values.shape[1] != samples.values.shape[1]:
            kept.clear()
        kept.append(samples)
        oldest = samples.stamps[-1] - self._kept_s
        while kept[0].stamps[-1] < oldest:
            kept.popleft()

    def keep_only(self, source_ids: Collection[str]) -> None:
        """Forget all other streams."""
        for name in self._chunks.keys() - source_ids:
            del self._chunks[name]

    def forget(self, source_ids: Collection[str]) -> None:
        """Forget these streams."""
        for name in source_ids & self._chunks.keys():
            del self._chunks[name]

    def newest(self, source_id: str) -> tuple[float, list[float | None]] | None:
        """Return stamp and values of the newest sample; None if there is none."""
        kept = self._chunks.get(source_id)
        if not kept:
            return None
        last = kept[-1]
        # JSON knows neither NaN nor infinity.
        values = [float(each) if math.isfinite(each) else None for each in last.values[-1]]
        return float(last.stamps[-1]), values

    def since(self, source_id: str, begin_s: float) -> Iterator[Samples]:
        """Yield what came after an LSL time."""
        for each in self._chunks.get(source_id, ()):
            if each.stamps[-1] > begin_s:
                yield each
