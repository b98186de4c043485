"""A folder with a table for each stream: a row a sample, a column a channel."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.batches import batches
from biosensor_gateway.recording.export.csv import tables
from biosensor_gateway.recording.export.exporter import (
    Clock,
    Order,
    Progress,
    SampleCount,
    on_clock,
)
from biosensor_gateway.recording.export.names import file_names
from biosensor_gateway.recording.export.numbers import rows_of_numbers

CONTENTS = "streams.json"
"""What the tables are, beside them."""


class WideCsv:
    """Writes a table for each stream that has samples, and ``streams.json``.

    Units, rates, participants and what else is known of a stream stand in the latter, for
    readers of tables expect one line of names and then numbers.

    Parameters
    ----------
    is_packed
        Whether the tables are compressed by gzip.
    """

    suffix = "_csv"

    def __init__(self, *, is_packed: bool = False) -> None:
        self._is_packed = is_packed

    def write(
        self, chosen: Chosen, order: Order, target: Path, progress: Progress
    ) -> Sequence[str]:
        """See :class:`.Exporter`."""
        target.mkdir()
        suffix = ".csv.gz" if self._is_packed else ".csv"
        count = SampleCount(chosen, progress)
        described: list[dict[str, Any]] = []
        for stream, name in zip(chosen.streams, file_names(chosen.streams), strict=True):
            path = target / f"{name}{suffix}"
            samples = self._write_stream(chosen, stream, order.clock, path, count)
            described.append(_described(stream, order.clock, samples, path.name))
        content = {
            "recording": chosen.contents.path.name,
            "clock": order.clock.value,
            "begun": chosen.contents.begun,
            "streams": described,
        }
        text = json.dumps(content, indent=2, ensure_ascii=False)
        (target / CONTENTS).write_text(text + "\n", "utf-8", newline="\n")
        return ()

    def _write_stream(
        self, chosen: Chosen, stream: Stream, clock: Clock, path: Path, count: SampleCount
    ) -> int:
        written = 0
        with tables.table_file(path, is_packed=self._is_packed) as file:
            names = [tables.time_column(clock), *tables.columns(stream)]
            file.write(tables.quoted([names]))
            for samples in batches(chosen, stream):
                file.write(_rows(chosen, clock, samples))
                written += len(samples)
                count.add(len(samples))
        return written


def _rows(chosen: Chosen, clock: Clock, samples: Samples) -> bytes:
    times = on_clock(chosen, clock, samples.times)
    if isinstance(samples.values, list):
        rows = zip(times.tolist(), samples.values, strict=True)
        return tables.quoted((time_s, *texts) for time_s, texts in rows)
    return rows_of_numbers(times, samples.values)


def _described(stream: Stream, clock: Clock, samples: int, file: str) -> dict[str, Any]:
    header, identity = stream.header, stream.header.identity
    return {
        "file": file,
        "name": header.name,
        "type": header.content_type,
        "source_id": header.source_id,
        "participant": identity.participant if identity else "",
        "sensor": identity.sensor if identity else "",
        "unit": identity.unit if identity else "",
        "nominal_rate_hz": header.rate,
        "format": header.format.value,
        "samples": samples,
        "columns": [
            {"name": tables.time_column(clock), "unit": "s"},
            *(
                {"name": name, "label": label, "unit": unit}
                for name, label, unit in zip(
                    tables.columns(stream), header.labels, stream.meaning.units, strict=True
                )
            ),
        ],
    }
