"""Runs: consecutive samples without a gap between them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_common.lsl.inlet import Block, Stamps


class Run(NamedTuple):
    """Consecutive samples of a block without a gap.

    Attributes
    ----------
    samples, stamps
        As in a block.
    sequence
        Number of the first sample: how many of this stream the node received before it.
    """

    samples: NDArray[Any]
    stamps: Stamps
    sequence: int


def part(block: Block, start: int, end: int, sequence: int) -> Run:
    """Return samples *start* to *end* of a block whose first sample has this number."""
    return Run(block.samples[start:end], block.stamps[start:end], sequence + start)


def split(run: Run, chosen: NDArray[np.bool_], *, alone: bool) -> list[Run]:
    """Return the chosen samples as runs, each with consecutive numbers.

    Parameters
    ----------
    alone
        Whether each sample becomes a separate run.
    """
    if chosen.all() and not alone:
        return [run]
    places = np.flatnonzero(chosen)
    breaks = np.arange(1, len(places)) if alone else np.flatnonzero(np.diff(places) > 1) + 1
    block = Block(run.samples, run.stamps)
    groups = np.split(places, breaks) if len(places) else []
    return [part(block, int(group[0]), int(group[-1]) + 1, run.sequence) for group in groups]
