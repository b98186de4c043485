"""Finds markers: what happened, as texts with their times."""

from __future__ import annotations

from collections.abc import Iterator

from biosensor_common.naming import AGENT, NODE
from biosensor_common.quantities import ChannelFormat, ContentType
from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.contents.wall_clock import EVENTS


def marker_streams(chosen: Chosen) -> list[Stream]:
    """Return the streams of markers, but for what agents and nodes tell of themselves."""
    return [each for each in chosen.streams if _is_markers(each)]


def markers(chosen: Chosen) -> Iterator[tuple[float, str]]:
    """Give time and text of each marker in the order of time, channels joined by commas."""
    for stream, samples in Chosen(
        chosen.contents, tuple(marker_streams(chosen)), chosen.begin_s, chosen.end_s
    ).merged():
        assert stream.header.format is ChannelFormat.STRING
        for time_s, texts in zip(samples.times.tolist(), samples.values, strict=True):
            yield time_s, ", ".join(texts)


def _is_markers(stream: Stream) -> bool:
    header, identity = stream.header, stream.header.identity
    if header.format is not ChannelFormat.STRING or header.content_type != ContentType.MARKERS:
        return False
    is_own = identity is not None and identity.sensor in {AGENT, NODE}
    return not (is_own and header.data_name == EVENTS)
