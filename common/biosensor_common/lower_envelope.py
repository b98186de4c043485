"""Fits a line under a sliding window of points: clock skew from one-way delays.

`LateRun` detects when packets stay late, so that the line no longer holds.

Notes
-----
Delays are non-negative. If they are exponentially distributed, the most likely
line is the one under all points with the least sum of distances, which is the
edge of the lower convex hull that spans the mean abscissa [1]_, [2]_. Here it is
the median abscissa: the same for steady packets, and a single late packet after a
pause cannot tilt the line.

A few packets determine that edge's slope badly (it may exceed the drift of any
oscillator tenfold). So the slope has a prior, and the line is the mean of all lines
under the points, each weighted by how likely it is: the estimate with the least
expected square error [3]_, where the most likely line alone turns from one edge of
the hull to the next. Delays of neighbouring packets are alike, and rare just above
their minimum, so that points carry less information than as many independent ones:
their likelihood is raised to a power below 1, as is usual where a model is only nearly
true [4]_.

.. [1] S. Moon, P. Skelly, D. Towsley, "Estimation and removal of clock skew from
   network delay measurements", IEEE INFOCOM 1999.
.. [2] L. Zhang, Z. Liu, C. H. Xia, "Clock synchronization algorithms for network
   measurements", IEEE INFOCOM 2002.
.. [3] E. J. G. Pitman, "The estimation of the location and scale parameters of a
   continuous population of any given form", Biometrika 30, 1939.
.. [4] C. C. Holmes, S. G. Walker, "Assigning a value to a power likelihood in a general
   Bayesian model", Biometrika 104, 2017.
.. [5] B. Epstein, M. Sobel, "Life testing", Journal of the American Statistical
   Association 48, 1953: an exponential's mean from the first few of many.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean, median

BIN_S = 0.5
WINDOW_BINS = 240
"""Two minutes, or more where packets are rare: after a pause, the bins before it are still the
best estimate of the drift."""
SLOPE_LIMIT = 250e-6
SLOPE_STEP = 10e-6
SLOPES = tuple(step * SLOPE_STEP for step in range(-40, 41))
"""Slopes that are averaged; they exceed the limit on both sides, or the mean would be biased."""
USUAL_SLOPE = 20e-6
"""SD of the slopes of good oscillators; a slope is the difference of two clocks' errors."""
UNUSUAL_SHARE = 0.2
"""Share of the prior that is uniform, so that a poor oscillator's slope is not pulled to 0."""
POWER = 0.31
"""Power of the likelihood: over a real radio, three half seconds carry as much information as one
with independent delays. With more the line turns too early, with less it follows drift late."""
NEAR_S = 1.0
"""Points further above the line say nothing about it, so they must not shift the middle."""
DELAY_FLOOR_S = 1e-4
"""Added to the mean delay: no computer measures an arrival more exactly."""
DELAY_CEILING_S = 0.1
"""Largest mean delay assumed. A longer one is not radio jitter: packets were held back and came
together, and the last of them is hardly late."""
EDGE_SHARE, EDGE_POINTS = 0.1, 4
"""Least number of lowest points from which the density of delays at their edge is estimated."""
FORGET_BELOW_S = 0.2
"""A point this far under the line is a clock step, so earlier points are discarded."""

Point = tuple[float, float]


class LowerEnvelope:
    """The line under the lowest points of the recent past; starts with the point (0, 0).

    It runs a little below the lowest points: by the expected difference between the
    smallest of so many delays and the smallest possible one.

    Keeps the lowest point of each half second, so that memory and work are bounded
    at any packet rate.

    Parameters
    ----------
    slope : float
        Expected slope, seconds per second: the centre of the prior.

    Attributes
    ----------
    slope : float
        Slope of the line, seconds per second.
    mean_delay : float
        Mean delay of the lowest points of each half second, in seconds.
    """

    def __init__(self, slope: float) -> None:
        self._log_prior = [_log_prior(each - slope) for each in SLOPES]
        self.slope = slope
        self._intercept = 0.0
        self.mean_delay = 0.0
        self._bins = [0]
        self._x = [0.0]
        self._y = [0.0]

    def at(self, x: float) -> float:
        """Return the line's height at `x`, in seconds."""
        return self._intercept + self.slope * x

    def residual_rms(self) -> float:
        """Return the RMS distance of the kept points from the line, in seconds."""
        squares = ((y - self.at(x)) ** 2 for x, y in zip(self._x, self._y, strict=True))
        return math.sqrt(math.fsum(squares) / len(self._x))

    def add(self, x: float, y: float) -> None:
        """Add one point.

        The line is fitted again when a bin is complete or the point is under the
        line.

        Parameters
        ----------
        x : float
            Time in seconds; may lie a little before earlier ones.
        y : float
            Arrival minus device time, in seconds.
        """
        height = y - self.at(x)
        if height < -FORGET_BELOW_S:
            self._bins, self._x, self._y = [], [], []
        opened = self._put(x, y)
        if opened or height < 0.0:
            self._fit()

    def _put(self, x: float, y: float) -> bool:
        """Keep the point if it is the lowest of its bin; return whether the bin is new."""
        number = math.floor(x / BIN_S)
        place = len(self._bins)
        while place and self._bins[place - 1] > number:
            place -= 1
        if place and self._bins[place - 1] == number:
            place -= 1
            if y - self._y[place] < self.slope * (x - self._x[place]):
                self._x[place], self._y[place] = x, y
            return False
        self._bins.insert(place, number)
        self._x.insert(place, x)
        self._y.insert(place, y)
        if len(self._bins) > WINDOW_BINS:
            del self._bins[0], self._x[0], self._y[0]
        return True

    def _fit(self) -> None:
        """Average the lines under all points, each weighted by its posterior.

        With u the time from the middle, a line of slope b under all points has the
        height ``h(b) = min(y - b u)`` there. For exponential delays of mean m the
        log-likelihood of n points is ``(n / m) h(b)``, and the least of the delays is
        expected at m / n, not at 0.
        """
        near = [x for x, y in zip(self._x, self._y, strict=True) if y - self.at(x) < NEAR_S]
        count = len(self._x)
        middle = (near or self._x)[len(near) // 2]
        hull = [(x - middle, y) for x, y in self._hull()]
        heights = [min(y - slope * u for u, y in hull) for slope in SLOPES]
        # Two points define the line exactly, so they hold no information about delays.
        density = POWER * max(count - 2, 0) / (self.mean_delay + DELAY_FLOOR_S)
        logs = [
            density * height + log for height, log in zip(heights, self._log_prior, strict=True)
        ]
        likeliest = max(logs)
        weights = [math.exp(log - likeliest) for log in logs]
        slope = min(max(fmean(SLOPES, weights), -SLOPE_LIMIT), SLOPE_LIMIT)
        above = sorted(y - slope * (x - middle) for x, y in zip(self._x, self._y, strict=True))
        self.mean_delay = _mean_delay(above)
        self.slope = slope
        self._intercept = above[0] - self.mean_delay / count - slope * middle

    def _hull(self) -> list[Point]:
        """Return the lower convex hull, left to right (Andrew's monotone chain)."""
        hull: list[Point] = []
        for x, y in zip(self._x, self._y, strict=True):
            while len(hull) > 1:
                (x0, y0), (x1, y1) = hull[-2], hull[-1]
                if (y1 - y0) * (x - x0) < (y - y0) * (x1 - x0):
                    break
                hull.pop()
            hull.append((x, y))
        return hull


def _log_prior(drift: float) -> float:
    """Return the log density of a mixture of a normal and a uniform distribution."""
    usual = math.exp(-0.5 * (drift / USUAL_SLOPE) ** 2) / (USUAL_SLOPE * math.sqrt(2 * math.pi))
    unusual = 1 / (SLOPES[-1] - SLOPES[0])
    return math.log((1 - UNUSUAL_SHARE) * usual + UNUSUAL_SHARE * unusual)


def _mean_delay(heights: Sequence[float]) -> float:
    """Estimate the mean of exponential delays from points in rising order.

    One estimate uses the median, because a mean would follow every stall. The other uses
    the lowest tenth alone, since the density of delays at their edge is what counts [5]_:
    where packets are held back and come together, half of them may be seconds late and
    the others not at all. The smaller estimate is taken.
    """
    lowest, count = heights[0], len(heights)
    by_median = (median(heights) - lowest) / math.log(2)
    edge = min(max(EDGE_POINTS, round(EDGE_SHARE * count)), count)
    # Two of the points define the line.
    if edge <= 2:
        return 0.0
    waited = math.fsum(height - lowest for height in heights[:edge])
    by_edge = (waited + (count - edge) * (heights[edge - 1] - lowest)) / (edge - 2)
    return min(by_median, by_edge, DELAY_CEILING_S)


SAME_MOMENT_S = 0.002


@dataclass(frozen=True, slots=True)
class Patience:
    """How long late packets count as a stall, once their delays no longer shrink.

    Attributes
    ----------
    seconds : float
        Least time over which they came.
    observations : int
        Least number of moments at which they came; packets that waited together come at one.
    spread : float
        Largest difference between the earliest packets of each second, as a part of their least
        delay: after a clock step all are late by the same time, after a stall they are not.
    """

    seconds: float
    observations: int
    spread: float = math.inf


class LateRun:
    """The present run of consecutive late packets.

    Attributes
    ----------
    began_behind : bool
        Whether the first of them was measured long before packets that had already arrived.
    least : float
        Their smallest lateness, in seconds; infinite if no packet is late.
    """

    def __init__(self) -> None:
        self.began_behind = False
        self.least = math.inf
        self._since = self._until = self._second = math.nan
        self._count = 0
        self._least_of_second = math.inf
        self._largest_least = -math.inf
        # Lateness of the packet at which the waiting began.
        self._settled = math.inf

    def add(self, late_s: float, limit_s: float, arrival_s: float, *, behind: bool = False) -> None:
        """Add a packet; one that is not late by more than the limit ends the run.

        A packet that is less late than all before it, by more than the limit, belongs to a
        backlog that is catching up: the waiting starts again with it.
        """
        if late_s <= limit_s:
            self.least = math.inf
            self._count = 0
            return
        if self._count == 0:
            self.began_behind = behind
            self._second, self._settled = arrival_s, math.inf
            self._least_of_second, self._largest_least = math.inf, -math.inf
        elif arrival_s - self._second >= 1.0:
            self._largest_least = max(self._largest_least, self._least_of_second)
            self._second, self._least_of_second = arrival_s, math.inf
        if late_s < self._settled - limit_s:
            self._settled, self._since, self._count = late_s, arrival_s, 0
        # After a clock step packets arrive one by one, as before; after a stall they come together.
        if self._count == 0 or arrival_s > self._until + SAME_MOMENT_S:
            self._count += 1
        self._until = arrival_s
        self._least_of_second = min(self._least_of_second, late_s)
        self.least = min(self.least, late_s)

    def outlasts(self, patience: Patience) -> bool:
        """Whether the run is too long for a stall."""
        return (
            self._count >= patience.observations
            and self._until - self._since >= patience.seconds
            and self._largest_least - self.least <= patience.spread * self.least
        )
