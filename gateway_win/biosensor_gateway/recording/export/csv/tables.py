"""What the tables of comma-separated values share: names of columns and files, texts, packing."""

from __future__ import annotations

import csv
import gzip
import io
import re
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.exporter import Clock

BATCH = 1 << 16
"""Values that are made text of at once: more cost memory, fewer time."""

_TIMES = {Clock.LSL: "lsl_time", Clock.WALL: "unix_time"}
# Faster than the usual 6 by half, and hardly larger.
_GZIP_LEVEL = 4
_UNSAFE = re.compile(r"[^A-Za-z0-9._+-]+")
_LONGEST_NAME = 80


def time_column(clock: Clock) -> str:
    """Return the name of the column of times, in s."""
    return _TIMES[clock]


@contextmanager
def table_file(path: Path, *, is_packed: bool) -> Generator[BinaryIO]:
    """Open a new file, which is compressed by gzip or not.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with ExitStack() as stack:
        file: BinaryIO = stack.enter_context(path.open("xb"))
        if is_packed:
            # Without the time of day and a name: equal contents make equal files.
            packing = gzip.GzipFile("", "wb", _GZIP_LEVEL, file, mtime=0)
            file = stack.enter_context(packing)  # type: ignore[assignment]
        yield file


def unique(names: Iterable[str]) -> list[str]:
    """Return names of which none is another's, also where upper case counts for nothing."""
    taken: set[str] = set()
    found: list[str] = []
    for name in names:
        candidate, number = name, 2
        while candidate.casefold() in taken:
            candidate, number = f"{name}_{number}", number + 1
        taken.add(candidate.casefold())
        found.append(candidate)
    return found


def file_names(streams: Sequence[Stream]) -> list[str]:
    """Return a name for a file of each stream, without suffix, that any system can take."""
    plain = (_UNSAFE.sub("_", each.header.name)[:_LONGEST_NAME].strip("._") for each in streams)
    named = zip(plain, streams, strict=True)
    return unique(name or f"stream_{each.number}" for name, each in named)


def columns(stream: Stream) -> list[str]:
    """Return a name for the column of each channel."""
    labels = stream.header.labels
    return unique(label.strip() or str(place) for place, label in enumerate(labels, 1))


def quoted(rows: Iterable[Sequence[str | float]]) -> bytes:
    """Return lines of texts, each in quotes, and numbers, without."""
    text = io.StringIO(newline="")
    csv.writer(text, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()


def batches(chosen: Chosen, stream: Stream) -> Iterator[Samples]:
    """Give the samples of a stream, many chunks of the file at once."""
    least = max(1, BATCH // stream.header.channel_count)
    kept: list[Samples] = []
    count = 0
    for samples in chosen.samples(stream):
        kept.append(samples)
        count += len(samples)
        if count >= least:
            yield _joined(kept)
            kept, count = [], 0
    if kept:
        yield _joined(kept)


def _joined(parts: Sequence[Samples]) -> Samples:
    times = np.concatenate([each.times for each in parts])
    stamps = np.concatenate([each.stamps for each in parts])
    texts = [text for each in parts if isinstance(each.values, list) for text in each.values]
    arrays = [each.values for each in parts if not isinstance(each.values, list)]
    return Samples(times, stamps, np.concatenate(arrays) if arrays else texts)
