"""Finds values that a converter or a link repeats, and signals that are clipped.

A living signal never repeats its values exactly, except by chance where its steps are coarse.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.features import parameters as at
from biosensor_gateway.features.runs import Array

_FACTOR = 0x9E3779B97F4A7C15
"""Odd, so that it has an inverse modulo 2^64."""


def repeats(values: Array, rate: float) -> dict[str, bool]:
    """Return whether a signal is flat, and whether it is clipped at one of its extremes.

    Both are measured in time, not in samples, because a converter with coarse steps repeats more
    values the faster it samples. A signal with a value that is held for a moment, or with a block
    that was sent twice, is flat, too; not judged where steps are coarser than the noise, for a
    heart at rest then stays at a value, and its beats are alike by chance.
    """
    changes = np.flatnonzero(np.diff(values)) + 1
    begins, ends = np.append(0, changes), np.append(changes, len(values))
    runs_s = (ends - begins) / rate
    flat_s = runs_s[runs_s >= at.FLAT_RUN_S].sum()
    before = values[np.maximum(0, begins - max(1, round(at.CLIPPED_APPROACH_S * rate)))]
    levels = values[begins]
    is_fast = np.abs(levels - before) >= at.CLIPPED_APPROACH * np.ptp(values)
    clipped_s = sum(_clipped_s(sign * levels, runs_s, is_fast, 1 / rate) for sign in (1, -1))
    whole_s = len(values) / rate
    is_clipped = clipped_s >= at.CLIPPED_SHARE * whole_s
    # What is clipped holds its extremes.
    comes_again = not is_clipped and _comes_again(values, np.repeat(runs_s, ends - begins), rate)
    return {
        "flat": bool(flat_s >= at.FLAT_SHARE * whole_s or comes_again),
        "clipped": bool(is_clipped),
    }


def _clipped_s(levels: Array, runs_s: Array, is_fast: NDArray[np.bool_], period_s: float) -> float:
    """Return the time that a signal stays at its maximum, after a rise too steep for a rounded top.

    At a rounded top it stays about as long as at the level below.
    """
    highest = levels.max()
    below = levels[levels < highest]
    if not len(below):
        return 0.0
    top_s = runs_s[(levels == highest) & is_fast]
    below_s = runs_s[levels == below.max()]
    is_rounded = top_s.sum() <= at.CLIPPED_TO_BELOW * below_s.sum()
    return 0.0 if is_rounded else float((top_s - period_s).sum())


def _comes_again(values: Array, runs_s: Array, rate: float) -> bool:
    """Whether a value is held, or a part comes again exactly, though noise makes it improbable.

    Parameters
    ----------
    runs_s
        Length of the run of equal values to which each value belongs.
    """
    is_long = runs_s >= at.HELD_S
    levels, ranks = np.unique(values, return_inverse=True)
    # Differences of the fourth order are those of noise; of neighbours, which are independent.
    bends = np.abs(np.diff(values, 4))[~is_long[4:]]
    if not len(bends):
        return False
    noise = at.OF_MEDIAN * float(np.median(bends)) / math.sqrt(70)
    steps = noise / float(np.diff(levels).min())
    if steps < at.FINE_STEPS:
        return False
    # What an equal neighbour tells, and what each value of a part that comes again.
    bits_held = math.log2(2 * math.sqrt(math.pi) * steps)
    bits_again = math.log2(math.sqrt(2 * math.pi * math.e) * steps)
    name_bits = math.log2(len(values))
    usual_s = float(np.quantile(runs_s[~is_long], at.HELD_USUAL))
    least_s = max(at.HELD_S, at.HELD_TIMES * usual_s)
    if runs_s.max() >= max(least_s, (1 + (at.REPEAT_BITS + name_bits) / bits_held) / rate):
        return True
    least = (at.REPEAT_BITS + 2 * name_bits) / bits_again
    length = max(round(at.TWICE_S * rate), at.TWICE_LEAST, math.ceil(least))
    if length > len(values) // 2:
        return False
    sums = np.sort(_sums(ranks.astype(np.uint64), length))
    return bool((sums[1:] == sums[:-1]).any())


def _sums(numbers: NDArray[np.uint64], length: int) -> NDArray[np.uint64]:
    """Return a checksum of the numbers from each place on; equal for equal numbers."""
    powers = np.cumprod(np.full(len(numbers), _FACTOR, np.uint64))
    inverse = np.cumprod(np.full(len(numbers), pow(_FACTOR, -1, 1 << 64), np.uint64))
    sums = np.append(np.uint64(0), np.cumsum(numbers * inverse, dtype=np.uint64))
    found: NDArray[np.uint64] = (sums[length:] - sums[:-length]) * powers[: len(sums) - length]
    return found
