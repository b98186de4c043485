"""Skewness and kurtosis."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray


def moment(values: NDArray[np.float64], order: Literal[3, 4]) -> float:
    """Return skewness or kurtosis; 0 where nothing moves."""
    centred = values - values.mean()
    spread = float(np.sqrt(np.square(centred).mean()))
    if spread <= 0:
        return 0.0
    scaled: NDArray[np.float64] = centred / spread
    squares = np.square(scaled)
    # np.power takes twenty times as long.
    return float((squares * (scaled if order == 3 else squares)).mean())
