"""Finds what was received in what was sent: slices of it, in order, with gaps only."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.faults.recorder import Floats, Recorded
from tests.rigs.lab_client import Samples

NEAR_S = 3.0
"""A stamp is never so far from the truth; values alone may repeat themselves."""
_LOOK_AHEAD = 16
"""So many equal samples in a row make a place as good as any with more."""


class Slice(NamedTuple):
    """Received samples ``first`` and so on are those of the truth at ``place`` and so on."""

    first: int
    place: int
    length: int


class UnknownSampleError(AssertionError):
    """A sample was never sent, or came twice, or too late."""


def match(received: Recorded, truth: Samples) -> list[Slice]:
    """Slices of the truth that make up what was received, none overlapping another.

    Raises
    ------
    UnknownSampleError
    """
    # As precise as an LSL stream of floats.
    sent, got = truth.values.astype(np.float32), received.values.astype(np.float32)
    slices: list[Slice] = []
    position = place = 0
    while position < len(got):
        place += _place(
            got[position : position + _LOOK_AHEAD],
            sent[place:],
            truth.times[place:] - received.times[position],
        )
        length = _common(got[position:], sent[place:])
        if not length:
            what = f"{got[position].tolist()} at {received.times[position]:.3f}"
            raise UnknownSampleError(f"sample {position}, {what}, was not sent, or came before")
        slices.append(Slice(position, place, length))
        position, place = position + length, place + length
    return slices


def missing(times: Floats, truth: Samples, drift_ppm: float = 0.0) -> int:
    """Samples that a regular stream lacks between others, at the device's own pace.

    Parameters
    ----------
    times
        When those that arrived were measured.
    truth
        Of which the pace is taken.
    drift_ppm
        How fast the device's crystal runs.
    """
    if len(times) < 2:
        return 0
    period_s = float(np.median(np.diff(truth.times)))
    # Where measuring began anew, a gap is no whole number of periods.
    steps = np.round(np.diff(times) / period_s * (1 + drift_ppm * 1e-6)).astype(int)
    return int(np.maximum(0, steps - 1).sum())


def matched_times(slices: Sequence[Slice], truth: Samples) -> Floats:
    """When each received sample was measured."""
    parts = [truth.times[each.place : each.place + each.length] for each in slices]
    return np.concatenate(parts) if parts else np.empty(0)


def _place(head: NDArray[np.float32], sent: NDArray[np.float32], apart_s: Floats) -> int:
    """The place nearest in time among those where most of *head* fits; 0 if there is none."""
    near = np.flatnonzero(np.abs(apart_s) < NEAR_S)
    fitting = [(_common(head, sent[at : at + len(head)]), -abs(apart_s[at]), at) for at in near]
    best = max((each for each in fitting if each[0]), default=(0, 0.0, 0))
    return int(best[2])


def _common(a: NDArray[np.float32], b: NDArray[np.float32]) -> int:
    size = min(len(a), len(b))
    same = np.isclose(a[:size], b[:size], rtol=2e-6, atol=1e-6, equal_nan=True).all(axis=1)
    differs = np.flatnonzero(~same)
    return int(differs[0]) if len(differs) else size
