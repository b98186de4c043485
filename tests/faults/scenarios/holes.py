"""How many samples of a stream are missing between two calm times of a recording.

Other than `tests.rigs.hosts.completeness`, which says whether anything is missing, this
counts what is, over a fault of any length.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.rigs.hosts.completeness import Recording, Span

# How far two receivers' times of arrival may be apart while all is calm.
NEAR_S = 2.0
# The same of programs that are starved while others work.
STARVED_S = 20.0

Rows = NDArray[np.int64]


class Hole(NamedTuple):
    """Samples of a reference, one after the other, that were not observed."""

    missing: int
    # begin_s, end_s: times of the last before them and the first after them in the reference (Unix
    # time).
    begin_s: float
    end_s: float


def hole(reference: Recording, observed: Recording, before: Span, after: Span) -> Hole | None:
    """Find the one hole between two calm times; see `missing`.

    Returns
    -------
    Hole or None
        None if nothing is missing.

    Raises
    ------
    ValueError
        If nothing was observed in one of the times, what was is no part of the reference,
        or more is missing than one hole.
    """
    begin, end = _within(observed, before), _within(observed, after)
    if not len(begin) or not len(end):
        raise ValueError("nothing came in a calm time")
    first = _place(reference, observed, begin, STARVED_S)
    last = _place(reference, observed, end, STARVED_S) + len(end)
    came = observed.rows[begin[0] : end[-1] + 1]
    count = last - first - len(came)
    head = _common(reference.rows[first:last], came)
    tail = _common(reference.rows[first:last][::-1], came[::-1])
    if head + tail < len(came) or count < 0:
        raise ValueError(f"{count} of {last - first} samples are missing, in several places")
    if not count:
        return None
    edges = reference.arrivals[[first + head - 1, first + head + count]]
    return Hole(count, *map(float, edges))


def missing(reference: Recording, observed: Recording, before: Span, after: Span) -> int | None:
    """Count the samples of a reference that were not observed.

    Parameters
    ----------
    reference, observed
        What was sent, and what came of it, in order.
    before, after
        Two times in which all that was sent came at once; counted is what is missing
        between the first sample of the one and the last of the other.

    Returns
    -------
    int or None
        None if nothing was observed in one of the times.

    Raises
    ------
    ValueError
        If what was observed in a calm time is no part of the reference.
    """
    begin, end = _within(observed, before), _within(observed, after)
    if not len(begin) or not len(end):
        return None
    first = _place(reference, observed, begin)
    last = _place(reference, observed, end) + len(end) - 1
    return int((last - first) - (end[-1] - begin[0]))


def place(reference: Recording, observed: Recording, span: Span) -> int:
    """Return which sample of the reference is the first that was observed in a calm time.

    Raises
    ------
    ValueError
        If what was observed is no part of the reference.
    """
    return _place(reference, observed, _within(observed, span))


def _within(recording: Recording, span: Span) -> Rows:
    return np.flatnonzero(span.holds(recording.arrivals))


def _place(reference: Recording, observed: Recording, rows: Rows, near_s: float = NEAR_S) -> int:
    """Where in the reference these neighbouring rows are; of several places the punctual one."""
    part = observed.rows[rows]
    times = observed.arrivals[rows]
    near = np.flatnonzero(np.abs(reference.arrivals - times[0]) < near_s)
    near = near[_alike(reference.rows[near], part[:1])]
    fitting = [
        (float(np.median(np.abs(reference.arrivals[at : at + len(rows)] - times))), int(at))
        for at in near
        if _are_equal(reference.rows[at : at + len(rows)], part)
    ]
    if not fitting:
        raise ValueError(f"{len(rows)} samples in a row are not what was sent at {times[0]:.3f}")
    return min(fitting)[1]


def _are_equal(sent: NDArray[np.generic], came: NDArray[np.generic]) -> bool:
    return len(sent) == len(came) == _common(sent, came)


def _common(sent: NDArray[np.generic], came: NDArray[np.generic]) -> int:
    """How many samples are the same from the first on."""
    size = min(len(sent), len(came))
    differs = np.flatnonzero(~_alike(sent[:size], came[:size]))
    return int(differs[0]) if len(differs) else size


def _alike(sent: NDArray[np.generic], came: NDArray[np.generic]) -> NDArray[np.bool_]:
    """Say of each sample whether it is the other's; a single one is compared with all.

    Numbers are as precise as an LSL stream of floats.
    """
    is_number = sent.dtype.kind == "f"
    same = (
        np.isclose(sent, came, rtol=2e-6, atol=1e-6, equal_nan=True) if is_number else sent == came
    )
    return np.all(same, axis=1)
