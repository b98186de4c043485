"""A straight line through measured points, and how sure its slope is."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

_LEAST_POINTS = 5


@dataclass(frozen=True, slots=True)
class Slope:
    """Slope of a line, with the ends of its 95 % interval."""

    value: float
    low: float
    high: float


def fit(x: ArrayLike, y: ArrayLike) -> Slope:
    """Fit by ordinary least squares; deviations are taken as independent and normal.

    Raises
    ------
    ValueError
        If there are fewer than five points.
    """
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    if len(x) < _LEAST_POINTS:
        raise ValueError(f"{len(x)} points are too few for a slope, give it more time")
    deviation = x - x.mean()
    slope = float(deviation @ y / (deviation @ deviation))
    residual = y - y.mean() - slope * deviation
    freedom = len(x) - 2
    error = float(np.sqrt(residual @ residual / freedom / (deviation @ deviation)))
    margin = error * _student_quantile(0.975, freedom)
    return Slope(slope, slope - margin, slope + margin)


def _student_quantile(probability: float, freedom: int) -> float:
    """Quantile of Student's t; Abramowitz and Stegun 26.7.5, to 1 % from 3 degrees on."""
    z, f = NormalDist().inv_cdf(probability), freedom
    return (
        z
        + (z**3 + z) / (4 * f)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * f**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * f**3)
    )
