"""Joins the samples of many chunks, because the exports' cost depends on the number of calls."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream

_BATCHES_IN_SECTION = 64


def batches(chosen: Chosen, stream: Stream) -> Iterator[Samples]:
    """Yield the samples of a stream, many chunks of the file at once."""
    least = max(1, chosen.batch // stream.header.channel_count)
    kept: list[Samples] = []
    count = 0
    for samples in chosen.samples(stream):
        kept.append(samples)
        count += len(samples)
        if count >= least:
            yield joined(kept)
            kept, count = [], 0
    if kept:
        yield joined(kept)


def section(chosen: Chosen) -> int:
    """Return how many samples of a stream are analysed together to find its runs."""
    return _BATCHES_IN_SECTION * chosen.batch


def joined(parts: Sequence[Samples]) -> Samples:
    """Join consecutive samples of one stream."""
    times = np.concatenate([each.times for each in parts])
    stamps = np.concatenate([each.stamps for each in parts])
    texts = [text for each in parts if isinstance(each.values, list) for text in each.values]
    arrays = [each.values for each in parts if not isinstance(each.values, list)]
    return Samples(times, stamps, np.concatenate(arrays) if arrays else texts)
