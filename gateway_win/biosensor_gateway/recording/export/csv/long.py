"""Exports one table for all streams, with one row per value."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export import tables
from biosensor_gateway.recording.export.exporter import (
    ExportOptions,
    Progress,
    SampleCount,
    on_clock,
)
from biosensor_gateway.recording.export.runs import (
    BAD_GAP,
    Gap,
    Runs,
    batches,
    gap_text,
    has_even_times,
)
from biosensor_gateway.recording.export.tables import numbers, unique

COLUMNS = ("participant", "stream", "channel", "unit", "value", "text")
"""Columns after the time; either `value` (numbers) or `text` is filled, the other is empty."""


class LongCsv:
    """Writes one table, stream by stream, each in the order of the recording.

    Parameters
    ----------
    is_packed
        Whether it is compressed by gzip.
    """

    def __init__(self, *, is_packed: bool = False) -> None:
        self._is_packed = is_packed
        self.suffix = ".csv.gz" if is_packed else ".csv"

    def write(
        self, chosen: Chosen, options: ExportOptions, target: Path, progress: Progress
    ) -> Sequence[str]:
        """See :class:`.Exporter`."""
        count = SampleCount(chosen, progress)
        names = unique(each.header.name for each in chosen.streams)
        notes: list[str] = []
        with tables.table_file(target, is_packed=self._is_packed) as file:
            file.write(tables.quoted([[tables.time_column(options.clock), *COLUMNS]]))
            for stream, name in zip(chosen.streams, names, strict=True):
                channels = _channels(stream, name)
                given: Iterator[Samples] = batches(chosen, stream)
                runs = None
                if has_even_times(stream, options.times):
                    runs = Runs(chosen, stream, options.times)
                    given = runs.samples()
                for samples in given:
                    times = numbers(on_clock(chosen, options.clock, samples.times))
                    file.write(_rows(times, channels, samples))
                    count.add(len(samples))
                if runs is None:
                    continue
                gaps = runs.gaps()
                begins = np.array([each.begin_s for each in gaps])
                times = numbers(on_clock(chosen, options.clock, begins))
                file.write(_gap_rows(times, stream, name, gaps))
                notes += [f"{name}: {told}" for told in runs.remarks_on_times()]
                if gaps:
                    told = gap_text([each.lost for each in gaps])
                    notes.append(f"{name}: {told}, each a line with the text {BAD_GAP}")
        return notes


def _gap_rows(times: Sequence[bytes], stream: Stream, name: str, gaps: Sequence[Gap]) -> bytes:
    """Return a line for each gap, with its length as the value."""
    identity = stream.header.identity
    who = identity.participant if identity else ""
    return b"".join(
        time_s + b"," + tables.quoted([[who, name, "", "s", each.length_s, BAD_GAP]])
        for time_s, each in zip(times, gaps, strict=True)
    )


def _channels(stream: Stream, name: str) -> list[bytes]:
    """Return the columns between time and value, for each channel."""
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
    # Each row has four parts, each filled in for all rows at once.
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
