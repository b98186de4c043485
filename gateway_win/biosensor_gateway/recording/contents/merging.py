"""Gives the samples of many streams in the order of time."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator

from biosensor_gateway.recording.contents.stream import Samples, Stream


def merged(
    streams: Iterable[Stream], begin_s: float, end_s: float
) -> Iterator[tuple[Stream, Samples]]:
    """Give chunks of samples of all streams by the time of their first sample.

    One chunk of each stream is kept in memory. Within a stream the order is that of the file.
    """

    def timed(place: int, stream: Stream) -> Iterator[tuple[float, int, Stream, Samples]]:
        for samples in stream.blocks(begin_s, end_s):
            yield float(samples.times[0]), place, stream, samples

    runs = (timed(place, stream) for place, stream in enumerate(streams))
    for _, _, stream, samples in heapq.merge(*runs, key=lambda each: each[:2]):
        yield stream, samples
