"""Fits a line under a sliding window of points: clock skew from one-way delays.

Notes
-----
Delays are non-negative. If they are exponentially distributed, the most likely
line is the one under all points with the least sum of distances, which is the
edge of the lower convex hull that spans the mean abscissa [1]_, [2]_. Here it is
the median abscissa: the same for steady packets, and a single late packet after a
pause cannot tilt the line. A few packets determine that edge's slope badly (it may
exceed the drift of any crystal tenfold), so the slope has a Gaussian prior and the
line is the maximum a posteriori one: as points gather it becomes the hull edge.

.. [1] S. Moon, P. Skelly, D. Towsley, "Estimation and removal of clock skew from
   network delay measurements", IEEE INFOCOM 1999.
.. [2] L. Zhang, Z. Liu, C. H. Xia, "Clock synchronization algorithms for network
   measurements", IEEE INFOCOM 2002.
.. [3] B. Epstein, M. Sobel, "Life testing", Journal of the American Statistical
   Association 48, 1953: an exponential's mean from the first few of many.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from statistics import median

BIN_S = 0.5
WINDOW_BINS = 240
"""Two minutes, or more where packets are rare: after a pause, the bins from before it
are still the best knowledge of the drift."""
SLOPE_LIMIT = 250e-6
SLOPE_PRIOR_SD = 100e-6
DELAY_FLOOR_S = 1e-3
"""Smallest mean delay assumed, so that two points never claim to know the slope."""
DELAY_CEILING_S = 0.1
"""Largest mean delay assumed: a longer one is not a radio's jitter, but packets that are
held back and come together, of which the last is hardly late."""
EDGE_SHARE, EDGE_POINTS = 0.1, 4
"""How many of the lowest points tell how dense the delays are at their edge, at least."""
FORGET_BELOW_S = 0.2
"""A point this far under the line is a step of the clock: what was before misleads."""

Point = tuple[float, float]


class LowerEnvelope:
    """The line under the lowest points of the recent past; starts with the point (0, 0).

    It runs a little below the lowest points: by what the best of so many delays is
    expected to miss the smallest possible one.

    Keeps the lowest point of each half second, so memory and work are bounded
    whatever the packet rate.

    Parameters
    ----------
    slope : float
        Expected slope, seconds per second: the centre of the prior.
    """

    def __init__(self, slope: float) -> None:
        self._prior = slope
        self._slope = slope
        self._intercept = 0.0
        self._mean_delay = 0.0
        self._bins = [0]
        self._x = [0.0]
        self._y = [0.0]

    @property
    def slope(self) -> float:
        """Slope of the line, seconds per second."""
        return self._slope

    @property
    def mean_delay(self) -> float:
        """By how much the lowest points of each half second are late in the mean, in seconds."""
        return self._mean_delay

    def at(self, x: float) -> float:
        """Return the line's height at `x`, in seconds."""
        return self._intercept + self._slope * x

    def residual_rms(self) -> float:
        """Return the RMS distance of the kept points from the line, in seconds."""
        squares = ((y - self.at(x)) ** 2 for x, y in zip(self._x, self._y, strict=True))
        return math.sqrt(math.fsum(squares) / len(self._x))

    def add(self, x: float, y: float) -> None:
        """Take in one point.

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
        """Keep the point if it is the lowest of its bin; tell whether the bin is new."""
        number = math.floor(x / BIN_S)
        place = len(self._bins)
        while place and self._bins[place - 1] > number:
            place -= 1
        if place and self._bins[place - 1] == number:
            place -= 1
            if y - self._y[place] < self._slope * (x - self._x[place]):
                self._x[place], self._y[place] = x, y
            return False
        self._bins.insert(place, number)
        self._x.insert(place, x)
        self._y.insert(place, y)
        if len(self._bins) > WINDOW_BINS:
            del self._bins[0], self._x[0], self._y[0]
        return True

    def _fit(self) -> None:
        """Maximise the posterior: the line's height in the middle, less the prior's price.

        With u the time from the middle, a line of slope b under all points has the
        height ``h(b) = min(y - b u)`` there. For exponential delays of mean m the
        log-posterior of n points is ``(n / m) h(b) - (b - prior)**2 / (2 sd**2)``:
        concave, so its maximum lies where the line rests on one vertex of the hull or
        on one edge.
        """
        count = len(self._x)
        middle = self._x[count // 2]
        hull = self._hull()
        stiffness = (self._mean_delay + DELAY_FLOOR_S) / (count * SLOPE_PRIOR_SD**2)
        slope = _most_likely_slope(hull, middle, self._prior, stiffness)
        slope = min(max(slope, -SLOPE_LIMIT), SLOPE_LIMIT)
        heights = sorted(y - slope * (x - middle) for x, y in zip(self._x, self._y, strict=True))
        self._mean_delay = _mean_delay(heights)
        # The least of n such delays is expected at mean / n, not at 0.
        self._slope = slope
        self._intercept = heights[0] - self._mean_delay / count - slope * middle

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


def _mean_delay(heights: Sequence[float]) -> float:
    """Estimate the mean of exponential delays from points in rising order.

    By the median, because a mean would follow every stall; and by the lowest tenth alone,
    since what counts is how dense the delays are at their edge [3]_: where packets are
    held and come together, half of them may be late by seconds, and the others not at
    all. The smaller estimate is taken.
    """
    lowest, count = heights[0], len(heights)
    by_median = (median(heights) - lowest) / math.log(2)
    edge = min(max(EDGE_POINTS, round(EDGE_SHARE * count)), count)
    if edge == 1:
        return 0.0
    waited = math.fsum(height - lowest for height in heights[:edge])
    by_edge = (waited + (count - edge) * (heights[edge - 1] - lowest)) / (edge - 1)
    return min(by_median, by_edge, DELAY_CEILING_S)


def _most_likely_slope(hull: list[Point], middle: float, prior: float, stiffness: float) -> float:
    """Walk along the hull until the posterior no longer rises with the slope.

    While the line rests on the vertex at x, the posterior has its maximum at
    ``prior - (x - middle) / stiffness``, if the edges at that vertex let the line
    reach it.
    """
    left_edge = -math.inf
    for (x, y), (next_x, next_y) in pairwise(hull):
        right_edge = (next_y - y) / (next_x - x)
        slope = prior - (x - middle) / stiffness
        if slope <= right_edge:
            return max(slope, left_edge)
        left_edge = right_edge
    return max(prior - (hull[-1][0] - middle) / stiffness, left_edge)
