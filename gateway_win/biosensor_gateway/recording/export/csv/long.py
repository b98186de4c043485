"""One table for all streams: a row a value."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.batches import batches
from biosensor_gateway.recording.export.csv import tables
from biosensor_gateway.recording.export.exporter import (
    Order,
    Progress,
    SampleCount,
    on_clock,
)
from biosensor_gateway.recording.export.names import unique
from biosensor_gateway.recording.export.numbers import numbers

COLUMNS = ("participant", "stream", "channel", "unit", "value", "text")
"""Behind the time; a number stands in `value`, a text in `text`, and the other one is empty."""


class LongCsv:
    """Writes one table, one stream after the other, each in the order of the recording.

    Parameters
    ----------
    is_packed
        Whether it is compressed by gzip.
    """

    def __init__(self, *, is_packed: bool = False) -> None:
        self._is_packed = is_packed
        self.suffix = ".csv.gz" if is_packed else ".csv"

    def write(
        self, chosen: Chosen, order: Order, target: Path, progress: Progress
    ) -> Sequence[str]:
        """See :class:`.Exporter`."""
        count = SampleCount(chosen, progress)
        names = unique(each.header.name for each in chosen.streams)
        with tables.table_file(target, is_packed=self._is_packed) as file:
            file.write(tables.quoted([[tables.time_column(order.clock), *COLUMNS]]))
            for stream, name in zip(chosen.streams, names, strict=True):
                channels = _channels(stream, name)
                for samples in batches(chosen, stream):
                    times = numbers(on_clock(chosen, order.clock, samples.times))
                    file.write(_rows(times, channels, samples))
                    count.add(len(samples))
        return ()


def _channels(stream: Stream, name: str) -> list[bytes]:
    """Return what stands between time and value, for each channel."""
    identity = stream.header.identity
    participant = identity.participant if identity else ""
    units = stream.meaning.units
    return [
        b"," + tables.quoted([[participant, name, column, unit]])[:-1] + b","
        for column, unit in zip(tables.columns(stream), units, strict=True)
    ]


def _rows(times: Sequence[bytes], channels: Sequence[bytes], samples: Samples) -> bytes:
    if isinstance(samples.values, list):
        return _text_rows(times, channels, samples.values)
    width = len(channels)
    # Four parts a row, each put in its place for all rows at once.
    parts: list[bytes] = [b",\n"] * (4 * width * len(times))
    for place, channel in enumerate(channels):
        parts[4 * place :: 4 * width] = times
        parts[4 * place + 1 :: 4 * width] = [channel] * len(times)
    parts[2::4] = numbers(samples.values)
    return b"".join(parts)


def _text_rows(
    times: Sequence[bytes], channels: Sequence[bytes], rows: Sequence[Sequence[str]]
) -> bytes:
    return b"".join(
        time_s + channel + b"," + tables.quoted([[text]])
        for time_s, row in zip(times, rows, strict=True)
        for channel, text in zip(channels, row, strict=True)
    )
