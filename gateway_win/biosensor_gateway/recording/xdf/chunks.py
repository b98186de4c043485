"""Writes an XDF file chunk by chunk, like LabRecorder.

The contents of chunks are specified at https://github.com/sccn/xdf/wiki/Specifications.
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
from biosensor_gateway.recording.xdf.container import (
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
    """The data of a stream's footer."""

    @property
    def first(self) -> float:
        """Timestamp of the first sample, 0 without samples."""
        ...

    @property
    def last(self) -> float:
        """Timestamp of the last sample, 0 without samples."""
        ...

    @property
    def sample_count(self) -> int:
        """Number of samples."""
        ...

    @property
    def clock_offsets(self) -> Sequence[tuple[float, float]]:
        """LSL times on the stream's clock, with the offsets to the recorder's clock, in s."""
        ...


def begin(
    file: BinaryIO, begun: str, clock: Sequence[ClockPair], resolution_s: float = 0.0
) -> None:
    """Write the start of a file.

    Parameters
    ----------
    begun
        Date and time of the start, in ISO 8601; empty if unknown.
    clock
        Moments on the file's clock and in Unix time; an extension that only this program reads.
    resolution_s
        Maximum error of these pairs.
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
    """Return a boundary chunk, at which readers continue after damage."""
    return framed(Tag.BOUNDARY, BOUNDARY)


def stream_header(number: int, xml: str | bytes) -> bytes:
    """Return the chunk of a stream's header, with unchanged XML."""
    return framed(Tag.STREAM_HEADER, _number(number) + _encoded(xml))


def samples(
    number: int,
    form: ChannelFormat,
    stamps: NDArray[np.float64],
    values: NDArray[Any] | Texts | RawTexts,
) -> bytes:
    """Return a chunk of samples, each with its timestamp.

    Parameters
    ----------
    stamps : ndarray of float64, shape (n,)
    values : ndarray, shape (n, n_channels), or list of tuple
        Values in the format of the stream; text may be bytes, as another program sent it.
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
    """Return a clock offset chunk."""
    return framed(Tag.CLOCK_OFFSET, _number(number) + _OFFSET.pack(taken_at, offset))


def footer(number: int, stream: Ended) -> bytes:
    """Return a stream footer chunk for the samples written, like LabRecorder."""
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
