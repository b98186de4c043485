"""How many samples of a stream are missing between two calm times of a recording.

Other than `tests.rigs.hosts.completeness`, which says whether anything is missing, this
counts what is, over a fault of any length.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.rigs.hosts.completeness import Span
from tests.rigs.hosts.recordings import Recording

# How far two receivers' times of arrival may be apart while all is calm.
NEAR_S = 2.0

Rows = NDArray[np.int64]


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


def _place(reference: Recording, observed: Recording, rows: Rows) -> int:
    """Where in the reference these neighbouring rows are; of several places the punctual one."""
    part = observed.rows[rows]
    times = observed.arrivals[rows]
    near = np.flatnonzero(np.abs(reference.arrivals - times[0]) < NEAR_S)
    fitting = [
        (float(np.median(np.abs(reference.arrivals[at : at + len(rows)] - times))), int(at))
        for at in near
        if _are_equal(reference.rows[at : at + len(rows)], part)
    ]
    if not fitting:
        raise ValueError(f"{len(rows)} samples in a row are not what was sent at {times[0]:.3f}")
    return min(fitting)[1]


def _are_equal(sent: NDArray[np.generic], came: NDArray[np.generic]) -> bool:
    is_number = sent.dtype.kind == "f"
    return len(sent) == len(came) and np.array_equal(sent, came, equal_nan=is_number)
