"""Names of columns and files, texts and packing of all tables of comma-separated values."""

from __future__ import annotations

import csv
import gzip
import io
from collections.abc import Generator, Iterable, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import BinaryIO

from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export import names
from biosensor_gateway.recording.export.exporter import Clock

_TIMES = {Clock.LSL: "lsl_time", Clock.WALL: "unix_time"}
SECONDS = "seconds"
"""Name of the column of times since the begin of what was exported."""
MARKERS = "all_markers.csv"
"""All that happened, of all streams of markers, in one table."""
# Faster than the usual 6 by half, and hardly larger.
_GZIP_LEVEL = 4


def time_column(clock: Clock) -> str:
    """Return the name of the column of times, in s."""
    return _TIMES[clock]


@contextmanager
def table_file(path: Path, *, is_packed: bool, level: int = _GZIP_LEVEL) -> Generator[BinaryIO]:
    """Open a new file, which is compressed by gzip or not.

    Parameters
    ----------
    level
        Of gzip, 1 to 9.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with ExitStack() as stack:
        file: BinaryIO = stack.enter_context(path.open("xb"))
        if is_packed:
            # Without the time of day and a name: equal contents make equal files.
            packing = gzip.GzipFile("", "wb", level, file, mtime=0)
            file = stack.enter_context(packing)  # type: ignore[assignment]
        yield file


def columns(stream: Stream) -> list[str]:
    """Return a name for the column of each channel."""
    labels = stream.header.labels
    return names.unique(label.strip() or str(place) for place, label in enumerate(labels, 1))


def own_columns(stream: Stream) -> list[str]:
    """Return the same where columns of times stand before them, whose names no channel has."""
    taken = [*_TIMES.values(), SECONDS]
    return names.unique([*taken, *columns(stream)])[len(taken) :]


def quoted(rows: Iterable[Sequence[str | float]]) -> bytes:
    """Return lines of texts, each in quotes, and numbers, without."""
    text = io.StringIO(newline="")
    csv.writer(text, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()
