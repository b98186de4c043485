"""Whether what was received is all that was sent: every sample once, in order.

A reference received the same streams on a way where nothing can be lost. What was
observed must be a part of it without a hole. Values tell where the part begins; where
they repeat themselves, as a battery's, the times of arrival tell.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

# How far two receivers' times of arrival may be apart on a busy machine.
MARGIN_S = 2.0
_WINDOW_S = 5.0
_EQUALLY_NEAR_S = 0.005
# Samples come to both without delay for half of a window, or to what is observed for this share.
_PROMPT_SHARES = (0.02, 0.5)

Codes = NDArray[np.int64]


class Span(NamedTuple):
    """A time, in seconds of Unix time; its end is not part of it."""

    start: float
    end: float

    def holds(self, times: NDArray[np.float64]) -> NDArray[np.bool_]:
        return (times >= self.start) & (times < self.end)

    def windows(self) -> list[Span]:
        """Cut it into equal parts of some seconds."""
        count = max(1, int((self.end - self.start) / _WINDOW_S))
        edges = np.linspace(self.start, self.end, count + 1)
        return [Span(float(a), float(b)) for a, b in pairwise(edges)]


def fault(
    reference: Recording,
    observed: Recording,
    required: Span,
    calm: Sequence[Span],
    unfilled: int = 0,
) -> str:
    """Say what is wrong with what was observed; an empty text if nothing is.

    Parameters
    ----------
    reference
        All that was sent, from `MARGIN_S` before the required time to as long after it.
    observed
        What came of it, in order.
    required
        What the reference received in this time must be in *observed*.
    calm
        When samples come to both at about the same time.
    unfilled
        How many samples at the end may still wait for their chunk to be full.
    """
    wanted = np.flatnonzero(required.holds(reference.arrivals))
    part = observed.between(required.start - MARGIN_S, required.end + MARGIN_S)
    if not len(part.rows):
        return f"nothing came of {len(wanted)} samples" if len(wanted) > unfilled else ""
    whole_codes, codes = _codes(reference, part)
    starts = _starts(whole_codes, codes)
    if not starts:
        return f"{_missing(whole_codes, codes)} between the first and the last of {len(codes)}"
    start = _punctual(reference, part, starts, calm)
    if start is None:
        return "it fits what was sent, but not always when it was sent: samples are missing"
    if not len(wanted):
        return ""
    begin = start
    # A node or a subscriber that is held up may bring the last ones later than the part goes.
    end = begin + len(codes) + _came_later(reference, observed, part, begin)
    early, late = begin - int(wanted[0]), int(wanted[-1]) + 1 - end
    if early > 0 or late > unfilled:
        return f"{max(0, early)} samples are missing at the begin, {max(0, late)} at the end"
    return ""


def is_current(reference: Recording, observed: Recording, span: Span) -> bool:
    """Whether the newest sample of a time came."""
    sent, came = reference.between(*span).rows, observed.between(*span).rows
    if not len(sent):
        return True
    # At the end of the time one may have come to only one of them.
    next_sent = reference.between(span.end, span.end + MARGIN_S).rows[:1]
    newest = {row.tobytes() for row in np.concatenate([sent[-2:], next_sent])}
    return len(came) > 0 and came[-1].tobytes() in newest


def delays(reference: Recording, observed: Recording) -> NDArray[np.float64]:
    """Seconds by which each sample came later than to the reference; shape (n,).

    Raises
    ------
    ValueError
        If it is unclear which samples were observed.
    """
    starts = _starts(*_codes(reference, observed))
    if len(starts) != 1:
        raise ValueError(f"it fits what was sent in {len(starts)} places")
    sent = reference.arrivals[starts[0] : starts[0] + len(observed.rows)]
    return observed.arrivals - sent


def _starts(whole: Codes, part: Codes) -> list[int]:
    """Where the values allow the part to begin."""
    candidates = np.flatnonzero(whole[: max(0, len(whole) - len(part) + 1)] == part[0])
    return [int(at) for at in candidates if np.array_equal(whole[at : at + len(part)], part)]


def _came_later(reference: Recording, observed: Recording, part: Recording, start: int) -> int:
    """Count the samples that went on, one by one, behind a part that begins at a place."""
    rest = observed.between(float(np.nextafter(part.arrivals[-1], np.inf)), np.inf)
    sent = reference.rows[start + len(part.rows) :]
    count = min(len(sent), len(rest.rows))
    cut = [
        each._replace(rows=rows[:count]) for each, rows in ((reference, sent), (rest, rest.rows))
    ]
    whole, codes = _codes(*cut)
    differing = np.flatnonzero(whole != codes)
    return int(differing[0]) if len(differing) else count


def _missing(whole: Codes, part: Codes) -> str:
    """Tell from the places of its first and last samples how many are missing in between."""
    size = min(100, len(part) // 2)
    first, last = _starts(whole, part[:size]), _starts(whole, part[len(part) - size :])
    if not size or len(first) != 1 or len(last) != 1:
        return "a hole or a swap"
    return f"{last[0] - first[0] - (len(part) - size)} samples are missing"


def _codes(reference: Recording, part: Recording) -> tuple[Codes, Codes]:
    """Number the different samples: equal ones get one number, NaN like any value."""
    rows = np.concatenate([reference.rows, part.rows])
    if rows.dtype.kind == "f":
        rows = np.where(np.isnan(rows), np.float32(np.nan), rows)
    size = rows.dtype.itemsize * rows.shape[1]
    whole_rows = np.ascontiguousarray(rows).view(np.dtype((np.void, size))).ravel()
    codes = np.unique(whole_rows, return_inverse=True)[1]
    return codes[: len(reference.rows)], codes[len(reference.rows) :]


def _punctual(
    reference: Recording, part: Recording, starts: Sequence[int], calm: Sequence[Span]
) -> int | None:
    """Choose the place at which the part came when the reference did, all the time.

    A sample that is missing where all values are equal makes one place right before it
    and another one behind it, so that none is left.
    """
    whole, codes = _codes(reference, part)
    # A chunk comes when its last sample has come.
    last = np.flatnonzero(np.diff(part.arrivals, append=np.inf) > 0)

    def distance(start: int, here: NDArray[np.int64]) -> float:
        # Whoever is held up is late, and may be so for most of a window.
        late_s = part.arrivals[here] - reference.arrivals[start + here]
        return float(np.abs(np.quantile(late_s, _PROMPT_SHARES)).min())

    remaining = list(starts)
    for window in (each for span in calm for each in span.windows()):
        here = last[window.holds(part.arrivals[last])]
        if len(here):
            rivals = _rivals(whole, codes, starts, slice(here[0], here[-1] + 1))
            nearest = min(distance(start, here) for start in rivals) + _EQUALLY_NEAR_S
            remaining = [start for start in remaining if distance(start, here) <= nearest]
    return min(remaining, key=lambda start: distance(start, last), default=None)


def _rivals(whole: Codes, part: Codes, starts: Sequence[int], here: slice) -> set[int]:
    """Return the places, and those beside them that fit as well in one piece of the part."""
    fitting = set(starts)
    for start in (each + step for each in starts for step in (-1, 1)):
        begin, end = start + here.start, start + here.stop
        if begin >= 0 and np.array_equal(whole[begin:end], part[here]):
            fitting.add(start)
    return fitting


_FIELDS = ("arrivals", "stamps", "rows")


class Recording(NamedTuple):
    """Samples of one stream or topic in the order in which they came.

    Attributes
    ----------
    arrivals : ndarray of float64, shape (n,)
        Unix time at which each came, in seconds; all computers here share this clock.
    stamps : ndarray, shape (n,)
        Of a topic: header stamps in ns of Unix time, int64, 0 without a header. Of a
        stream: stamps on the sender's LSL clock in seconds, float64.
    rows : ndarray, shape (n, channels)
        Values, as float32 or text.
    """

    arrivals: NDArray[np.float64]
    stamps: NDArray[Any]
    rows: NDArray[Any]

    def between(self, start_s: float, end_s: float) -> Recording:
        """Return the samples that came from a time on and before another."""
        chosen = (self.arrivals >= start_s) & (self.arrivals < end_s)
        return Recording(self.arrivals[chosen], self.stamps[chosen], self.rows[chosen])


def save(path: Path, recordings: Mapping[str, Recording]) -> None:
    """Write recordings by name."""
    arrays = {
        f"{name}|{field}": array
        for name, recording in recordings.items()
        for field, array in zip(_FIELDS, recording, strict=True)
    }
    np.savez(path, allow_pickle=False, **arrays)


def load(path: Path) -> dict[str, Recording]:
    """Read what `save` wrote."""
    with np.load(path) as arrays:
        names = dict.fromkeys(key.rpartition("|")[0] for key in arrays.files)
        return {
            name: Recording(*(arrays[f"{name}|{field}"] for field in _FIELDS)) for name in names
        }


_COUNTERS = ("pushed", "lost", "last_stamp")


def canonical(counters: Mapping[str, Mapping[str, Any]]) -> str:
    """Write counters by source_id such that equal ones are equal texts.

    What else an entry may have, as the state of a device's clock, is left out.
    """
    floats = {
        source: {key: float(entry[key]) for key in _COUNTERS} for source, entry in counters.items()
    }
    return json.dumps(floats, sort_keys=True)


def lost_by_devices(reports: Recording, until_s: float) -> dict[str, float]:
    """Count what the agent says was lost before it came to LSL since it began, by source_id."""
    _, last = _first_and_last(reports, Span(0.0, until_s))
    return {source: entry["lost"] for source, entry in last.items()}


def _first_and_last(
    reports: Recording, span: Span
) -> tuple[dict[str, dict[str, float]], dict[str, dict[str, float]]]:
    texts = reports.between(*span).rows[:, 0]
    return json.loads(str(texts[0])), json.loads(str(texts[-1]))


def differences(reports: Recording, streams: Mapping[str, Recording], span: Span) -> dict[str, str]:
    """Compare what the agent says it pushed with what a receiver of its streams got.

    Parameters
    ----------
    reports
        The agent's counters.
    span
        Its first and last report in this time are compared.

    Returns
    -------
    dict of str
        What differs, by source_id; also what the agent says it has lost itself.
    """
    first, last = _first_and_last(reports, span)
    found: dict[str, str] = {}
    for source, end in last.items():
        begin, stamps = first[source], streams[source].stamps
        newer = stamps > begin["last_stamp"]
        received = int(np.count_nonzero(newer & (stamps <= end["last_stamp"])))
        pushed, lost = (end[key] - begin[key] for key in ("pushed", "lost"))
        if received != pushed or lost:
            found[source] = f"{pushed:.0f} pushed, {received} received, {lost:.0f} lost before"
    return found
