"""Makes one count and one time of what a device counts and reads off its clock.

Both begin anew at some number, and when the device does.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, unique

SLACK_S = 90.0
"""What waited for an agent that did not run, or on its way, is late by less."""
REORDERED = 32
"""Datagrams overtake each other by fewer lines than that."""
REORDERED_S = 1.0
MOST_LOST = 1_000_000
"""More in a row is no loss where no rate says how many there can have been."""
USUAL_TURN = 2**32


@unique
class Order(Enum):
    """Where a line belongs."""

    NEXT = "next"
    LATE = "late"
    """It was overtaken, or comes twice."""
    RESTART = "restart"
    """The device counts anew."""


@dataclass(frozen=True, slots=True)
class Place:
    """A line among the others.

    Attributes
    ----------
    order
    value
        Lines, or seconds, since the first one.
    step
        By how many more than the line before.
    """

    order: Order
    value: float
    step: float


class Unwrapped:
    """Follows a number that grows, turns over, and begins anew when its device does.

    Parameters
    ----------
    turns_over_at
        0 where it never does.
    reordered
        How far behind the newest a late one may be.
    may_repeat
        Whether two in a row may be the same, as of a clock with long ticks.
    """

    def __init__(self, turns_over_at: float, reordered: float, *, may_repeat: bool = False) -> None:
        self._turn = turns_over_at
        self._reordered = reordered
        self._may_repeat = may_repeat
        self._last: float | None = None
        self._total = 0.0
        self._is_anew = False

    def begin_anew(self) -> None:
        """Take the next one as the first of a device that was restarted."""
        self._is_anew = self._last is not None

    def step_to(self, number: float) -> float:
        """Return by how much a number is more than the one before; 0 for the first."""
        return 0.0 if self._last is None else number - self._last

    def place(self, number: float, most: float) -> Place:
        """Say where a number belongs.

        Parameters
        ----------
        number
            As the device sent it.
        most
            By how much it can have grown since the one before.
        """
        if self._last is None or self._is_anew:
            order = Order.RESTART if self._is_anew else Order.NEXT
            self._is_anew = False
            return self._take(order, number, 0.0)
        step = number - self._last
        # One from before the turn, if it seems far ahead.
        behind = self._turn - step if self._turn and step > self._turn / 2 else -step
        if 0 <= behind <= self._reordered and not (step == 0 and self._may_repeat):
            return Place(Order.LATE, self._total - behind, -behind)
        if step < 0 and self._last < self._turn:
            step += self._turn
        if not 0 <= step <= most:
            return self._take(Order.RESTART, number, 0.0)
        return self._take(Order.NEXT, number, step)

    def _take(self, order: Order, number: float, step: float) -> Place:
        self._last = number
        self._total = 0.0 if order is Order.RESTART else self._total + step
        return Place(order, self._total, step)
