"""Finds markers: texts of events with their times."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from biosensor_common.naming import AGENT, NODE
from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Stream

MARKERS = "markers"
"""Data name of the agent's own markers."""


def marker_streams(chosen: Chosen) -> list[Stream]:
    """Return the marker streams, except the agents' and nodes' own event streams."""
    streams = (each for each in chosen.streams if each.header.is_markers)
    return [each for each in streams if not _is_of_a_program(each)]


def markers(chosen: Chosen) -> Iterator[tuple[float, str]]:
    """Yield time and text of each marker in time order, with channels joined by commas."""
    for _, samples in Chosen(
        chosen.contents, tuple(marker_streams(chosen)), chosen.begin_s, chosen.end_s
    ).merged():
        for time_s, values in zip(samples.times.tolist(), samples.values, strict=True):
            yield time_s, ", ".join(texts(values))


def texts(values: Iterable[str | np.generic]) -> list[str]:
    """Return all channels of a marker as texts."""
    return [each if isinstance(each, str) else str(each.item()) for each in values]


def _is_of_a_program(stream: Stream) -> bool:
    identity = stream.header.identity
    if identity is None or identity.sensor not in {AGENT, NODE}:
        return False
    return stream.header.data_name != MARKERS
