"""Has lines wait for one that they overtook on their way, as datagrams do."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import isnan

from biosensor_gateway.devices.line_sensor.driver.protocol import Row

PATIENCE_S = 0.35
"""So long a line waits for one before it, as those of other senders of datagrams do."""
MOST_AHEAD = 32
"""What is further ahead overtook nothing: lines before it were lost, or the device counts again."""


class InOrder:
    """Hands lines out by their count.

    Parameters
    ----------
    at_count
        Where in a row the count is; None where there is none, or what carries lines keeps order.

    Attributes
    ----------
    is_needed
        Whether anything ever waits.
    """

    def __init__(self, at_count: int | None) -> None:
        self.is_needed = at_count is not None
        self._at_count = at_count
        self._last: float | None = None
        self._waiting: dict[float, tuple[Row, float]] = {}

    def take(self, rows: Iterable[Row], arrival_s: float) -> Iterator[tuple[Row, float]]:
        """Take in rows that came; return those whose turn it is, each with its own arrival."""
        for row in rows:
            if self._at_count is None or isnan(row[self._at_count]):
                yield row, arrival_s
            else:
                yield from self._placed(row, row[self._at_count], arrival_s)

    def end(self) -> list[tuple[Row, float]]:
        """Return what still waits; whatever comes next is the first."""
        left = [self._hand_out(count) for count in sorted(self._waiting)]
        self._last = None
        return left

    def _placed(self, row: Row, count: float, arrival_s: float) -> Iterator[tuple[Row, float]]:
        ahead = 1.0 if self._last is None else count - self._last
        if count in self._waiting or -MOST_AHEAD <= ahead < 1:
            # A copy, or later than anybody waits: who counts the lines says which.
            yield row, arrival_s
            return
        if ahead > MOST_AHEAD or ahead < 1:
            yield from self.end()
        self._waiting[count] = row, arrival_s
        while self._waiting and self._is_ripe(min(self._waiting), arrival_s):
            yield self._hand_out(min(self._waiting))

    def _is_ripe(self, count: float, now_s: float) -> bool:
        is_next = self._last is None or count == self._last + 1
        return is_next or now_s - self._waiting[count][1] > PATIENCE_S

    def _hand_out(self, count: float) -> tuple[Row, float]:
        self._last = count
        return self._waiting.pop(count)
