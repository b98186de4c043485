"""The agent's counters, as its stream and its topic carry them."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from tests.rigs.hosts.completeness import Span
from tests.rigs.hosts.recordings import Recording


def canonical(counters: Mapping[str, Mapping[str, float]]) -> str:
    """Write counters by source_id such that equal ones are equal texts."""
    floats = {
        source: {key: float(value) for key, value in entry.items()}
        for source, entry in counters.items()
    }
    return json.dumps(floats, sort_keys=True)


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
    texts = reports.between(*span).rows[:, 0]
    first, last = (json.loads(str(text)) for text in (texts[0], texts[-1]))
    found: dict[str, str] = {}
    for source, end in last.items():
        begin, stamps = first[source], streams[source].stamps
        newer = stamps > begin["last_stamp"]
        received = int(np.count_nonzero(newer & (stamps <= end["last_stamp"])))
        pushed, lost = (end[key] - begin[key] for key in ("pushed", "lost"))
        if received != pushed or lost:
            found[source] = f"{pushed:.0f} pushed, {received} received, {lost:.0f} lost before"
    return found
