"""Writes what can be read of a recording to another file."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.framing import (
    BOUNDARY,
    MAGIC,
    STREAM_ID_BYTES,
    Tag,
    framed,
    read_frame,
)
from biosensor_gateway.recording.xdf.salvage.kept import Restamp
from biosensor_gateway.recording.xdf.salvage.survey import Survey
from biosensor_gateway.recording.xdf.writing import footer
from biosensor_gateway.system.new_file import new_file

_BLOCK_BYTES = 1 << 20
_FILE_HEADER = b'<?xml version="1.0"?><info><version>1.0</version></info>'


def write_salvaged(source: BinaryIO, survey: Survey, target: Path, original: Path) -> None:
    """Write all chunks that are whole, unchanged, and the footers that are missing.

    Parameters
    ----------
    source
        The recording, uncompressed.
    target
        The file to write.
    original
        Who can read it can read the new file.

    Raises
    ------
    RecordingError
        If it cannot be written; there is no file then, unless there was one before.
    """
    try:
        with new_file(target, like=original) as file:
            _write(source, survey, file)
    except FileExistsError:
        message = f"{target} exists and is not overwritten"
        raise RecordingError(RecordingReason.UNWRITABLE, message) from None
    except OSError as error:
        message = f"cannot write {target}: {error.strerror or error}"
        raise RecordingError(RecordingReason.UNWRITABLE, message) from error


def _write(source: BinaryIO, survey: Survey, target: BinaryIO) -> None:
    target.write(MAGIC)
    if not survey.has_file_header:
        target.write(framed(Tag.FILE_HEADER, _FILE_HEADER))
    position = len(MAGIC)
    for start, end, instead in survey.changes():
        _copy(source, position, start, target)
        # A boundary chunk may stand anywhere, and so marks the place.
        target.write(_restamped(source, instead) if instead else framed(Tag.BOUNDARY, BOUNDARY))
        position = end
    _copy(source, position, survey.size, target)
    for number in survey.footers_due():
        target.write(footer(number, survey.streams[number]))


def _copy(source: BinaryIO, start: int, end: int, target: BinaryIO) -> None:
    source.seek(start)
    while start < end:
        block = source.read(min(_BLOCK_BYTES, end - start))
        if not block:
            raise OSError("the recording became shorter meanwhile")
        target.write(block)
        start += len(block)


def _restamped(source: BinaryIO, chunk: Restamp) -> bytes:
    """Return a samples chunk whose first sample has a stamp now."""
    frame = read_frame(source, chunk.start)
    source.seek(frame.content_start)
    content = source.read(chunk.end - frame.content_start)
    # Before the first sample stand the stream's number and, after its size, their count.
    first = STREAM_ID_BYTES + 1 + content[STREAM_ID_BYTES]
    stamp = b"\x08" + struct.pack("<d", chunk.stamp)
    return framed(Tag.SAMPLES, content[:first] + stamp + content[first + 1 :])
