"""Whether all that a device has sent was recorded: every sample once, in order, on time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.faults.matching import UnknownSampleError, match
from tests.faults.recorder import Recorded
from tests.rigs.hosts.completeness import Span
from tests.rigs.lab_client import Samples

Floats = NDArray[np.float64]


class Arrivals(NamedTuple):
    """What was recorded of one stream.

    Attributes
    ----------
    times : ndarray of float64, shape (n,)
        The stamps as Unix time, in seconds.
    values : ndarray of float64, shape (n, channels)
    """

    times: Floats
    values: Floats


def fault(sent: Samples, arrivals: Arrivals, required: Span) -> str:
    """Say what is wrong with what was recorded; an empty text if nothing is.

    Parameters
    ----------
    sent
        What the device has sent, with the Unix times of measuring.
    required
        What was measured in this time must have been recorded.
    """
    wanted = np.flatnonzero(required.holds(sent.times))
    try:
        places = _places(sent, arrivals)
    except UnknownSampleError as error:
        return str(error)
    came = places[np.isin(places, wanted)]
    if len(came) != len(wanted):
        return f"{len(wanted) - len(came)} of {len(wanted)} samples are missing"
    # Where values repeat themselves, one that is missing shows by the times of the others.
    spacing = np.diff(sent.times[places])
    steps = np.abs(np.diff(arrivals.times) - spacing)
    inside = required.holds(sent.times[places[1:]])
    if (steps[inside] > spacing[inside] / 2).any():
        return "the times fit only if a sample is missing or came twice"
    return ""


def stamp_errors(sent: Samples, arrivals: Arrivals, required: Span) -> Floats:
    """Seconds by which each sample of a time is stamped later than it was measured.

    Raises
    ------
    UnknownSampleError
        If a sample was never sent.
    """
    measured = sent.times[_places(sent, arrivals)]
    return (arrivals.times - measured)[required.holds(measured)]


def header_errors(sent: Samples, stamps: Floats, required: Span) -> Floats:
    """Return the same for a topic with nothing but stamps; it is known to be complete."""
    inside = stamps[required.holds(stamps)]
    if not len(inside):
        return inside
    start = int(np.abs(sent.times - inside[0]).argmin())
    return inside - sent.times[start : start + len(inside)]


def _places(sent: Samples, arrivals: Arrivals) -> NDArray[np.int64]:
    return match(Recorded(arrivals.times, arrivals.values, arrivals.times), sent)
