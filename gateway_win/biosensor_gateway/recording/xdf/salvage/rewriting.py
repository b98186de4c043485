"""Writes what can be read of a recording to another file."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO
from xml.etree import ElementTree as ET

from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason
from biosensor_gateway.recording.xdf.framing import (
    BOUNDARY,
    MAGIC,
    STREAM_ID_BYTES,
    Tag,
    framed,
    read_frame,
)
from biosensor_gateway.recording.xdf.salvage.kept import KeptStream, Restamp
from biosensor_gateway.recording.xdf.salvage.survey import Survey
from biosensor_gateway.system.new_file import new_file

_BLOCK_BYTES = 1 << 20
_FILE_HEADER = b'<?xml version="1.0"?><info><version>1.0</version></info>'
_XML = b'<?xml version="1.0"?>'


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
        content = number.to_bytes(STREAM_ID_BYTES, "little") + footer_xml(survey.streams[number])
        target.write(framed(Tag.STREAM_FOOTER, content))


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


def footer_xml(stream: KeptStream) -> bytes:
    """Return the footer that LabRecorder would have written of the samples that are there."""
    root = ET.Element("info")
    _add(root, "first_timestamp", _number(stream.first))
    _add(root, "last_timestamp", _number(stream.last))
    _add(root, "sample_count", str(stream.sample_count))
    offsets = ET.SubElement(root, "clock_offsets")
    for taken_at, value in stream.clock_offsets:
        offset = ET.SubElement(offsets, "offset")
        _add(offset, "time", _number(taken_at))
        _add(offset, "value", _number(value))
    return _XML + ET.tostring(root)


def _add(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = text


def _number(value: float) -> str:
    return repr(value) if value else "0"
