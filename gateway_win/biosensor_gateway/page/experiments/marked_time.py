"""Decides when a marker of a web experiment happened, or that it cannot have been then."""

from __future__ import annotations

import math

from biosensor_gateway.agent.marking import MAX_LEAD_S, MAX_WEB_AGE_S
from biosensor_gateway.page.experiments.browser_clock import BrowserClock
from biosensor_gateway.page.experiments.models import Mark
from biosensor_gateway.streaming.markers import TimedBy, Timing


class RefusedTimeError(Exception):
    """The time of a marker cannot be; its text is the sentence for the page.

    Attributes
    ----------
    is_clock
        Whether it may fit when the browser's clock has been measured anew.
    """

    def __init__(self, sentence: str, *, is_clock: bool = False) -> None:
        super().__init__(sentence)
        self.is_clock = is_clock


class MarkedTime:
    """Turns the times of one page's markers into LSL times.

    Parameters
    ----------
    clock
        Of the page.
    """

    def __init__(self, clock: BrowserClock) -> None:
        self._clock = clock
        self._doubted: int | None = None

    def of(self, mark: Mark, arrival: float) -> tuple[float, Timing]:
        """Return the LSL time at which a marker happened, in seconds, and how that is known.

        Parameters
        ----------
        mark
        arrival
            LSL time in seconds at which it came.

        Raises
        ------
        RefusedTimeError
            The clock is not known yet, or the time is too far from the arrival.
        """
        if mark.at is None:
            return arrival, Timing(TimedBy.ARRIVAL)
        if not self._clock.is_known:
            message = "the page's clock is not measured yet; it answers each ping with a pong"
            raise RefusedTimeError(message, is_clock=True)
        known = self._clock.to_lsl(mark.at / 1000)
        ahead_s = known.lsl_time - arrival
        if ahead_s > MAX_LEAD_S + known.uncertainty_s:
            raise self._of_the_future(mark.ref, ahead_s)
        if ahead_s < -MAX_WEB_AGE_S:
            message = f"it happened {-ahead_s:.0f} s ago, and {MAX_WEB_AGE_S:.0f} s is the limit"
            raise RefusedTimeError(message)
        self._doubted = None
        at = min(known.lsl_time, arrival + MAX_LEAD_S)
        # In the digits that are told, and not below what it is.
        return at, Timing(TimedBy.CLOCK, math.ceil(1e6 * known.uncertainty_s) / 1e6)

    def _of_the_future(self, ref: int, ahead_s: float) -> RefusedTimeError:
        # Either the page is wrong or its clock was set; the second time, it is the page.
        is_clock, self._doubted = self._doubted != ref, ref
        if is_clock:
            self._clock.forget()
        return RefusedTimeError(
            f"it would happen {ahead_s:.3f} s after it came, and {MAX_LEAD_S:g} s is the limit; "
            "'at' is when it happened, as performance.now() shows it",
            is_clock=is_clock,
        )
