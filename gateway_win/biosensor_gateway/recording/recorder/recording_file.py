"""Inspects a recording's file: whether it has samples, grows, and is closed.

LabRecorder creates the file at once but writes in blocks of some kilobytes (8 KiB on Linux), so
with a single slow stream the file may not grow for a minute.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from biosensor_gateway.recording.recorder.request import SUFFIXES, Target
from biosensor_gateway.recording.xdf.container import (
    Chunk,
    ChunkError,
    RecordingError,
    Tag,
    open_recording,
    read_chunks,
)
from biosensor_gateway.recording.xdf.header import parse_stream_header

_POLL_S = 0.25


@dataclass(slots=True)
class FileSummary:
    """The contents of a recording, without decoding its samples."""

    bytes: int = 0
    streams: set[int] = field(default_factory=set[int])  # Numbers of the streams with a header.
    # with_samples, with_footer: numbers of the streams with samples, and with a footer.
    with_samples: set[int] = field(default_factory=set[int])
    with_footer: set[int] = field(default_factory=set[int])
    # Streams that LabRecorder cannot record, so they never get a footer.
    without_footer_due: set[int] = field(default_factory=set[int])
    # Streams without a source_id: LabRecorder loses them for good, and writes no footer, if their
    # program ends before the recording.
    may_be_lost: set[int] = field(default_factory=set[int])
    is_whole: bool = False  # Whether it can be read to the end.

    @property
    def is_closed(self) -> bool:
        """Whether the recorder finished it."""
        due = self.streams - self.without_footer_due
        some = bool(self.with_footer) if due else bool(self.streams)
        return self.is_whole and some and due - self.may_be_lost <= self.with_footer

    def take(self, chunk: Chunk) -> None:
        """Process one chunk of the file."""
        if chunk.tag in (Tag.FILE_HEADER, Tag.BOUNDARY):
            return  # nothing is dropped: they hold no samples
        stream = chunk.stream_id
        if chunk.tag is Tag.SAMPLES:
            self.with_samples.add(stream)
        elif chunk.tag is Tag.STREAM_FOOTER:
            self.with_footer.add(stream)
        elif chunk.tag is Tag.STREAM_HEADER:
            self.streams.add(stream)
            try:
                header = parse_stream_header(bytes(chunk.body))
            except ChunkError:  # nothing is dropped: the verdict tells it
                return  # nothing is dropped: the verdict tells it
            if not header.is_recordable:
                self.without_footer_due.add(stream)
            if not header.source_id:
                self.may_be_lost.add(stream)


def summarize(path: Path) -> FileSummary:
    """Summarise a recording; a file that is not one yet gives an empty summary."""
    seen = FileSummary(bytes=size_of(path) or 0)
    try:
        with open_recording(path) as (file, size, is_unpacked_whole):
            seen.is_whole = not read_chunks(file, size, seen.take) and is_unpacked_whole
    except RecordingError:  # nothing is dropped: other files have no streams
        pass
    return seen


def size_of(path: Path) -> int | None:
    """Return the size of a file in bytes, None if there is none."""
    try:
        # Opened, because on Windows the folder entry of a file being written may be outdated.
        with path.open("rb") as file:
            return file.seek(0, 2)
    except OSError:  # nothing is dropped: the size of a file
        return None  # nothing is dropped: the size of a file


def sizes(target: Target) -> dict[Path, int]:
    """Return the possible files with their sizes."""
    paths: Iterable[Path] = target.files
    if not target.files and target.folder is not None:
        paths = (each for each in target.folder.rglob("*") if each.suffix.lower() in SUFFIXES)
    found = ((path, size_of(path)) for path in paths)
    return {path: size for path, size in found if size is not None}


def wait_for_growth(target: Target, before: Mapping[Path, int], limit_s: float) -> Path | None:
    """Wait until a recording has samples and grows; return its file, None if none grows.

    Parameters
    ----------
    before
        Sizes before the start; an unchanged file is not the recording.
    """
    deadline = time.monotonic() + limit_s
    first: dict[Path, int] = {}
    while True:
        for path, size in sizes(target).items():
            if size == before.get(path):
                continue  # nothing is dropped: it does not grow
            if size > first.setdefault(path, size) and summarize(path).with_samples:
                return path
        if time.monotonic() >= deadline:
            return None  # nothing is dropped: who asked is told that nothing grows
        time.sleep(_POLL_S)


def grows(path: Path, limit_s: float) -> bool:
    """Whether a file grows within `limit_s`; returns at once if it does."""
    first = size_of(path)
    return first is not None and _wait(lambda: (size_of(path) or 0) > first, limit_s)


def wait_until_closed(path: Path, still_s: float, limit_s: float) -> FileSummary | None:
    """Wait until a file is unchanged for `still_s`; return its summary, None if it changes."""
    last, since = size_of(path), time.monotonic()

    def is_still() -> bool:
        nonlocal last, since
        size, now = size_of(path), time.monotonic()
        if size != last:
            last, since = size, now
        return now - since >= still_s

    return summarize(path) if _wait(is_still, limit_s) else None


def _wait(condition: Callable[[], bool], limit_s: float) -> bool:
    deadline = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() >= deadline:
            return False
        time.sleep(_POLL_S)
    return True
