"""Blocks of samples on their way through the node."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Stamps = NDArray[np.float64]
"""LSL times in seconds, one a sample."""


class Block(NamedTuple):
    """Samples that were pulled together.

    Attributes
    ----------
    samples
        Shape [samples, channels], in the stream's own format; for text an array of
        objects that holds ``str``.
    stamps
        Times on the sender's LSL clock.
    """

    samples: NDArray[Any]
    stamps: Stamps


class Run(NamedTuple):
    """Samples of a block between which nothing is missing.

    Attributes
    ----------
    samples, stamps
        As in :class:`Block`.
    sequence
        Number of the first sample: how many of this stream the node got before it.
    """

    samples: NDArray[Any]
    stamps: Stamps
    sequence: int


def joined(first: Block, second: Block) -> Block:
    """Return the samples of both."""
    return Block(
        np.concatenate((first.samples, second.samples)),
        np.concatenate((first.stamps, second.stamps)),
    )


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
