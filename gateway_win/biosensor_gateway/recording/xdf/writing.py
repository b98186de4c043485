"""Writes an XDF file, chunk by chunk, as LabRecorder does.

See https://github.com/sccn/xdf/wiki/Specifications for what a chunk holds.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any, BinaryIO, Protocol
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from biosensor_common.quantities import ChannelFormat
from biosensor_common.ros_clock import ClockPair
from biosensor_gateway.recording.xdf.framing import (
    BOUNDARY,
    MAGIC,
    STREAM_ID_BYTES,
    Tag,
    framed,
)
from biosensor_gateway.recording.xdf.samples import Texts, record

RawTexts = list[tuple[bytes, ...]]

_XML = b'<?xml version="1.0"?>'
_STAMP = struct.Struct("<Bd")
_STAMP_BYTES = 8
_OFFSET = struct.Struct("<dd")


class Ended(Protocol):
    """What a footer tells of a stream."""

    @property
    def first(self) -> float:
        """Stamp of the first sample, 0 without any."""
        ...

    @property
    def last(self) -> float:
        """Stamp of the last one."""
        ...

    @property
    def sample_count(self) -> int:
        """How many there are."""
        ...

    @property
    def clock_offsets(self) -> Sequence[tuple[float, float]]:
        """LSL time on the stream's clock, and what to add to get the recorder's, in s."""
        ...


def begin(
    file: BinaryIO, begun: str, clock: Sequence[ClockPair], resolution_s: float = 0.0
) -> None:
    """Write the beginning of a file.

    Parameters
    ----------
    begun
        Date and time of day, in ISO 8601; empty if nobody knows.
    clock
        Moments on the file's clock and on that of the day, which no other program reads.
    resolution_s
        How far off these may be.
    """
    info = ET.Element("info")
    _add(info, "version", "1.0")
    if begun:
        _add(info, "datetime", begun)
    for pair in clock:
        node = ET.SubElement(info, "clock")
        _add(node, "resolution_s", repr(resolution_s))
        _add(node, "lsl_s", repr(pair.lsl_s))
        _add(node, "unix_ns", str(pair.unix_ns))
    file.write(MAGIC + framed(Tag.FILE_HEADER, _XML + ET.tostring(info)))


def boundary() -> bytes:
    """Return the chunk at which readers go on behind a damage."""
    return framed(Tag.BOUNDARY, BOUNDARY)


def stream_header(number: int, xml: str | bytes) -> bytes:
    """Return the chunk of a stream's header, with its XML as it is."""
    return framed(Tag.STREAM_HEADER, _number(number) + _encoded(xml))


def samples(
    number: int,
    form: ChannelFormat,
    stamps: NDArray[np.float64],
    values: NDArray[Any] | Texts | RawTexts,
) -> bytes:
    """Return a chunk of samples, each with its stamp.

    Parameters
    ----------
    stamps : ndarray of float64, shape (n,)
    values : ndarray, shape (n, n_channels), or list of tuple
        What the format of the stream can hold; text may be as bytes, as another program sent it.
    """
    head = _number(number) + b"\x04" + struct.pack("<I", len(stamps))
    if isinstance(values, list):
        return framed(Tag.SAMPLES, head + _texts(stamps, values))
    rows = np.empty(len(stamps), record(form, values.shape[1]))
    rows["size"], rows["stamp"], rows["values"] = _STAMP_BYTES, stamps, values
    return framed(Tag.SAMPLES, head + rows.tobytes())


def _encoded(text: str | bytes) -> bytes:
    return text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")


def _texts(stamps: NDArray[np.float64], values: Texts | RawTexts) -> bytes:
    parts: list[bytes] = []
    for stamp, sample in zip(stamps.tolist(), values, strict=True):
        parts.append(_STAMP.pack(_STAMP_BYTES, stamp))
        for text in sample:
            content = _encoded(text)
            parts.append(b"\x04" + struct.pack("<I", len(content)) + content)
    return b"".join(parts)


def clock_offset(number: int, taken_at: float, offset: float) -> bytes:
    """Return a chunk of one measurement of a stream's clock."""
    return framed(Tag.CLOCK_OFFSET, _number(number) + _OFFSET.pack(taken_at, offset))


def footer(number: int, stream: Ended) -> bytes:
    """Return the chunk that LabRecorder writes of the samples that are there."""
    root = ET.Element("info")
    _add(root, "first_timestamp", _decimal(stream.first))
    _add(root, "last_timestamp", _decimal(stream.last))
    _add(root, "sample_count", str(stream.sample_count))
    offsets = ET.SubElement(root, "clock_offsets")
    for taken_at, value in stream.clock_offsets:
        offset = ET.SubElement(offsets, "offset")
        _add(offset, "time", _decimal(taken_at))
        _add(offset, "value", _decimal(value))
    return framed(Tag.STREAM_FOOTER, _number(number) + _XML + ET.tostring(root))


def _add(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = text


def _decimal(value: float) -> str:
    return repr(value) if value else "0"


def _number(number: int) -> bytes:
    return number.to_bytes(STREAM_ID_BYTES, "little")
