"""Finds markers: what happened, as texts with their times."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from biosensor_common.naming import AGENT, NODE
from biosensor_common.quantities import ChannelFormat
from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Stream

MARKERS = "markers"
"""Data name of the agent's own."""
# Senders call them Markers, markers, Marker, StringMarker, LSL_Marker_Strings, Trigger, Events.
_WORDS = ("marker", "trigger", "event", "stim")


def is_markers(stream: Stream) -> bool:
    """Whether a stream tells what happened rather than what was measured.

    That is any text, of whatever type, and numbers without a rate whose type says so.
    """
    header = stream.header
    if header.format is ChannelFormat.STRING:
        return True
    kind = header.content_type.lower()
    return not header.is_regular and any(word in kind for word in _WORDS)


def marker_streams(chosen: Chosen) -> list[Stream]:
    """Return the streams of markers, but for what agents and nodes tell of themselves."""
    return [each for each in chosen.streams if is_markers(each) and not _is_of_a_program(each)]


def markers(chosen: Chosen) -> Iterator[tuple[float, str]]:
    """Give time and text of each marker in the order of time, channels joined by commas."""
    for _, samples in Chosen(
        chosen.contents, tuple(marker_streams(chosen)), chosen.begin_s, chosen.end_s
    ).merged():
        for time_s, values in zip(samples.times.tolist(), samples.values, strict=True):
            yield time_s, ", ".join(texts(values))


def texts(values: Iterable[str | np.generic]) -> list[str]:
    """Return all channels of a marker, as texts."""
    return [each if isinstance(each, str) else str(each.item()) for each in values]


def _is_of_a_program(stream: Stream) -> bool:
    identity = stream.header.identity
    if identity is None or identity.sensor not in {AGENT, NODE}:
        return False
    return stream.header.data_name != MARKERS
