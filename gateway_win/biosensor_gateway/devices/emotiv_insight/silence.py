"""Notices which streams have stopped, while the connection says nothing of it."""

from __future__ import annotations

from collections.abc import Iterable

STALLED_AFTER_S = 2.0
OVERDUE_AFTER_S = 10.0


class SilenceWatch:
    """Follows when each stream was last heard; times are those of any one clock.

    Parameters
    ----------
    streams
        Those that ought to come without a pause.
    now_s
        When they were asked for.
    """

    def __init__(self, streams: Iterable[str], now_s: float) -> None:
        self._heard_s = dict.fromkeys(streams, now_s)
        self._stalled: set[str] = set()

    @property
    def streams(self) -> frozenset[str]:
        """All that are watched."""
        return frozenset(self._heard_s)

    def heard(self, stream: str, now_s: float) -> None:
        """Note that a stream has sent something."""
        if stream in self._heard_s:
            self._heard_s[stream] = now_s

    def changes(self, now_s: float) -> dict[str, bool]:
        """Return the streams that stalled (True) or came back (False) since the last call."""
        stalled = self._silent_for(STALLED_AFTER_S, now_s)
        changed = stalled ^ self._stalled
        self._stalled = stalled
        return {stream: stream in stalled for stream in sorted(changed)}

    def overdue(self, now_s: float) -> frozenset[str]:
        """Return the streams for which something must be done."""
        return frozenset(self._silent_for(OVERDUE_AFTER_S, now_s))

    def _silent_for(self, limit_s: float, now_s: float) -> set[str]:
        return {stream for stream, heard_s in self._heard_s.items() if now_s - heard_s > limit_s}
