"""Names of columns and files, quoting and compression of all CSV tables."""

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
"""Name of the column with times since the start of the export."""
MARKERS = "all_markers.csv"
"""The table with the events of all marker streams."""
# Much faster than the default 6, with hardly larger files.
_GZIP_LEVEL = 4


def time_column(clock: Clock) -> str:
    """Return the name of the column with times in s."""
    return _TIMES[clock]


@contextmanager
def table_file(path: Path, *, is_packed: bool, level: int = _GZIP_LEVEL) -> Generator[BinaryIO]:
    """Open a new file, which is compressed by gzip or not.

    Parameters
    ----------
    level
        gzip level, 1 to 9.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with ExitStack() as stack:
        file: BinaryIO = stack.enter_context(path.open("xb"))
        if is_packed:
            # Without a time and a name, so that equal contents give equal files.
            packing = gzip.GzipFile("", "wb", level, file, mtime=0)
            file = stack.enter_context(packing)  # type: ignore[assignment]
        yield file


def columns(stream: Stream) -> list[str]:
    """Return a column name for each channel."""
    labels = stream.header.labels
    return names.unique(label.strip() or str(place) for place, label in enumerate(labels, 1))


def own_columns(stream: Stream) -> list[str]:
    """Return column names that differ from those of the time columns."""
    taken = [*_TIMES.values(), SECONDS]
    return names.unique([*taken, *columns(stream)])[len(taken) :]


def quoted(rows: Iterable[Sequence[str | float]]) -> bytes:
    """Return CSV lines in which texts are quoted and numbers are not."""
    text = io.StringIO(newline="")
    csv.writer(text, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()
