"""Relates a browser's clock to LSL's, by questions that the browser answers with its time."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

DRIFT = 1e-4
"""By how much a browser's clock may run faster or slower than LSL's."""
KEPT = 32
ENOUGH = 5
"""As many exchanges must have been made before a time is taken from them."""
COARSEST_S = 0.2
"""A browser that protects its user from being recognised shows its time in steps of 0.1 s."""


class Exchange(NamedTuple):
    """One question and its answer.

    Attributes
    ----------
    sent, received
        LSL time in seconds at which we asked and had the answer.
    at
        The browser's time in seconds at which it answered.
    """

    sent: float
    at: float
    received: float

    @property
    def offset(self) -> float:
        """LSL's time minus the browser's, if both ways took equally long."""
        return (self.sent + self.received) / 2 - self.at

    @property
    def half_s(self) -> float:
        """By how much the offset may be wrong: one way may have taken the whole time."""
        return (self.received - self.sent) / 2


class LslTime(NamedTuple):
    """A time of the browser on LSL's clock, and by how much it may be wrong; in seconds."""

    lsl_time: float
    uncertainty_s: float


class BrowserClock:
    """The clock of one page; whatever zero it counts from.

    Between question and answer, the browser's time is known to within the round trip, whatever
    the page was busy with. So the exchange counts that was the quickest, made wider by what the
    clocks may have drifted since. One that contradicts it says that the clock was set: what
    was known before is forgotten.

    Parameters
    ----------
    resolution_s
        Steps in which the browser shows its time, in seconds. Each time that it tells may be
        wrong by as much, and two always stand against each other.
    """

    def __init__(self, resolution_s: float) -> None:
        self._resolution_s = min(max(resolution_s, 0.0), COARSEST_S)
        self._exchanges: deque[Exchange] = deque(maxlen=KEPT)

    @property
    def is_known(self) -> bool:
        """Whether times can be taken from it."""
        return len(self._exchanges) >= ENOUGH

    @property
    def newest_uncertainty_s(self) -> float | None:
        """By how much a time of now may be wrong, in seconds; None while nothing is known."""
        if not self.is_known:
            return None
        return self.to_lsl(self._exchanges[-1].at).uncertainty_s

    def note(self, exchange: Exchange) -> bool:
        """Take an exchange in.

        Returns
        -------
        bool
            Whether it fits those before it; else it is the first one now.
        """
        fits = not self._exchanges or self._fits(exchange)
        if not fits:
            self._exchanges.clear()
        self._exchanges.append(exchange)
        return fits

    def forget(self) -> None:
        """Begin anew."""
        self._exchanges.clear()

    def to_lsl(self, at: float) -> LslTime:
        """Return a time of the browser, in seconds, as an LSL time.

        Raises
        ------
        ValueError
            It is not known yet.
        """
        if not self.is_known:
            raise ValueError("the browser's clock is not measured yet")
        best = min(self._exchanges, key=lambda each: _error_s(each, at))
        return LslTime(at + best.offset, _error_s(best, at) + 2 * self._resolution_s)

    def _fits(self, exchange: Exchange) -> bool:
        best = min(self._exchanges, key=lambda each: _error_s(each, exchange.at))
        allowed = _error_s(best, exchange.at) + exchange.half_s + 2 * self._resolution_s
        return abs(exchange.offset - best.offset) <= allowed


def _error_s(exchange: Exchange, at: float) -> float:
    return exchange.half_s + DRIFT * abs(at - exchange.at)
