"""Runs: samples on their way to topics, between which nothing is missing."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_common.lsl.inlet import Block, Stamps


class Run(NamedTuple):
    """Samples of a block between which nothing is missing.

    Attributes
    ----------
    samples, stamps
        As in a block.
    sequence
        Number of the first sample: how many of this stream the node got before it.
    """

    samples: NDArray[Any]
    stamps: Stamps
    sequence: int


def part(block: Block, start: int, end: int, sequence: int) -> Run:
    """Return samples *start* to *end* of a block whose first has that number."""
    return Run(block.samples[start:end], block.stamps[start:end], sequence + start)


def split(run: Run, chosen: NDArray[np.bool_], *, alone: bool) -> list[Run]:
    """Return the chosen samples as runs, each numbered without a hole.

    Parameters
    ----------
    alone
        Whether each sample becomes a run of its own.
    """
    if chosen.all() and not alone:
        return [run]
    places = np.flatnonzero(chosen)
    breaks = np.arange(1, len(places)) if alone else np.flatnonzero(np.diff(places) > 1) + 1
    block = Block(run.samples, run.stamps)
    groups = np.split(places, breaks) if len(places) else []
    return [part(block, int(group[0]), int(group[-1]) + 1, run.sequence) for group in groups]
