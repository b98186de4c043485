"""Finds what was received in what was sent: in order, each once, with gaps only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.faults.recorder import Floats, Recorded
from tests.rigs.lab_client import Samples

NEAR_S = 3.0
"""A stamp is never so far from the truth; values alone may repeat themselves."""
_USUAL = 0.9
"""So large a part of the samples is taken for as late as samples usually are."""
_LOOK_AHEAD = 16
"""So many equal samples in a row make a place as good as any with more."""

Places = NDArray[np.int64]
_Values = NDArray[np.float32]


class UnknownSampleError(AssertionError):
    """A sample was never sent, or came twice, or out of order."""


def match(received: Recorded, truth: Samples, near_s: float = NEAR_S) -> Places:
    """Place of each received sample in the truth, ever increasing, with a stamp that is near.

    Raises
    ------
    UnknownSampleError
    """
    # As precise as an LSL stream of floats.
    sent, got = truth.values.astype(np.float32), received.values.astype(np.float32)
    runs: list[Places] = []
    position = place = 0
    while position < len(got):
        apart_s = truth.times[place:] - received.times[position]
        place += _best(got[position:], sent[place:], apart_s, near_s)
        length = _common(got[position:], sent[place:])
        if not length:
            what = f"{got[position].tolist()} at {received.times[position]:.3f}"
            raise UnknownSampleError(f"sample {position}, {what}, was not sent, or came before")
        runs.append(np.arange(place, place + length))
        position, place = position + length, place + length
    return np.concatenate(runs) if runs else np.empty(0, np.int64)


def missing(places: Places, truth: Samples) -> int:
    """Samples that a regular stream would have had room for between those that arrived."""
    if len(places) < 2:
        return 0
    return int(np.maximum(0, _steps(places, truth) - 1).sum())


def held_up(received: Recorded, places: Places, truth: Samples) -> int:
    """Samples that fit into what held up those beside the gaps of a regular stream.

    That is by how much more than usual they came late: of the last before a gap and the first
    behind it, the one that was held up for longer.
    """
    if len(places) < 2:
        return 0
    late_s = received.arrivals - truth.times[places]
    held_up_s = np.maximum(0.0, late_s - np.quantile(late_s, _USUAL))
    gaps = np.flatnonzero(_steps(places, truth) > 1)
    longest_s = np.maximum(held_up_s[gaps], held_up_s[gaps + 1])
    return int(np.ceil(longest_s.sum() / _period_s(truth)))


def unread(places: Places) -> int:
    """Samples that were sent between those that arrived, and did not."""
    return int(places[-1] - places[0] + 1 - len(places)) if len(places) else 0


def _steps(places: Places, truth: Samples) -> NDArray[np.int64]:
    """How many periods each sample is behind the one before."""
    # Where measuring began again, a gap is no whole number of periods.
    return np.round(np.diff(truth.times[places]) / _period_s(truth)).astype(np.int64)


def _period_s(truth: Samples) -> float:
    return float(np.median(np.diff(truth.times)))


def _best(got: _Values, sent: _Values, apart_s: Floats, near_s: float) -> int:
    """The place nearest in time among those where the most of the next fit; 0 if there is none.

    From there on all that is got must have room: a heart that beats alike every 20 s fits in
    three places of a minute that came at once.
    """
    head, room = got[:_LOOK_AHEAD], max(0, len(sent) - len(got) + 1)
    near = np.flatnonzero(np.abs(apart_s[:room]) < near_s)
    # Most of them begin otherwise already, which is seen at one look.
    begin = near[_same(sent[near], head[:1])].tolist()
    fitting = (
        (_common(head, sent[place : place + len(head)]), -abs(float(apart_s[place])), place)
        for place in begin
    )
    _, _, place = max(fitting, default=(0, 0.0, 0))
    return place


def _common(a: _Values, b: _Values) -> int:
    """How many samples are the same from the first on."""
    size = min(len(a), len(b))
    differs = np.flatnonzero(~_same(a[:size], b[:size]))
    return int(differs[0]) if len(differs) else size


def _same(a: _Values, b: _Values) -> NDArray[np.bool_]:
    return np.all(np.isclose(a, b, rtol=2e-6, atol=1e-6, equal_nan=True), axis=1)
