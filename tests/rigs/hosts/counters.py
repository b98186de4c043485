"""The agent's counters, as its stream and its topic carry them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from tests.rigs.hosts.completeness import Span
from tests.rigs.hosts.recordings import Recording

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
