"""Writes BrainVision files, the EEG format that BIDS recommends.

They consist of a header (``.vhdr``), the recorded samples (``.eeg``) and markers (``.vmrk``),
according to the BrainVision Core Data Format 1.0. Values are never scaled: float32 and 16-bit
integers are kept exactly, other formats are rounded to float32.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from os import SEEK_END
from pathlib import Path
from typing import BinaryIO

import numpy as np

from biosensor_common.quantities import ChannelFormat
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.bids.file_names import write_text

_UNITS = {"microvolts": "µV", "uV": "µV", "millivolts": "mV", "volts": "V"}
_KINDS = {"INT_16": np.dtype("<i2"), "IEEE_FLOAT_32": np.dtype("<f4")}
_HEADER = """\
Brain Vision Data Exchange Header File Version 1.0
; Made by biosensor-gateway of the LSL stream {name}

[Common Infos]
Codepage=UTF-8
DataFile={data}
MarkerFile={markers}
DataFormat=BINARY
DataOrientation=MULTIPLEXED
NumberOfChannels={count}
; in microseconds
SamplingInterval={interval}

[Binary Infos]
BinaryFormat={kind}

[Channel Infos]
; Ch<number>=<name>,<reference>,<resolution>,<unit>
{channels}
"""
_MARKERS = """\
Brain Vision Data Exchange Marker File Version 1.0

[Common Infos]
Codepage=UTF-8
DataFile={data}

[Marker Infos]
; Mk<number>=<type>,<description>,<sample>,<length>,<channel, 0 for all>
{markers}
"""


_AT_ONCE = 1 << 16


class BinaryRows:
    """Writes samples as binary numbers, one row each.

    Parameters
    ----------
    is_small
        Whether the values are 16-bit integers. These cannot represent a missing value, so if one
        occurs all values are converted to float32, which is exact.
    """

    def __init__(self, file: BinaryIO, *, is_small: bool) -> None:
        self._file = file
        self.kind = "INT_16" if is_small else "IEEE_FLOAT_32"
        self.rows = 0
        self.empty: list[tuple[int, int]] = []  # First row and number of rows of each gap.

    def write(self, samples: Samples, count: int) -> None:
        """See :class:`.Rows`."""
        values = np.asarray(samples.values)[:count]
        with np.errstate(over="ignore"):
            self._file.write(values.astype(_KINDS[self.kind]).tobytes())
        self.rows += count

    def leave_empty(self, rows: int, width: int) -> None:
        """See :class:`.Rows`."""
        if self.kind == "INT_16":
            self._widen()
        self._file.write(np.full((rows, width), np.nan, _KINDS[self.kind]).tobytes())
        self.empty.append((self.rows, rows))
        self.rows += rows

    def _widen(self) -> None:
        """Convert the file to float32 in place, starting at its end."""
        narrow, wide = _KINDS["INT_16"], _KINDS["IEEE_FLOAT_32"]
        last = self._file.tell() // narrow.itemsize
        while last:
            first = max(0, last - _AT_ONCE)
            self._file.seek(first * narrow.itemsize)
            values = np.frombuffer(self._file.read((last - first) * narrow.itemsize), narrow)
            self._file.seek(first * wide.itemsize)
            self._file.write(values.astype(wide).tobytes())
            last = first
        self._file.seek(0, SEEK_END)
        self.kind = "IEEE_FLOAT_32"


def is_small(stream: Stream) -> bool:
    """Whether the samples are integers of at most 16 bits."""
    return stream.header.format in (ChannelFormat.INT8, ChannelFormat.INT16)


def is_exact(stream: Stream) -> bool:
    """Whether the recorded numbers are kept exactly."""
    exact = (ChannelFormat.INT8, ChannelFormat.INT16, ChannelFormat.FLOAT32)
    return stream.header.format in exact


def write_header(
    path: Path, stream: Stream, names: Sequence[str], kind: str, rate_hz: float
) -> None:
    """Write the header file.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    told = zip(names, stream.meaning.units, strict=True)
    channels = "\n".join(
        f"Ch{number}={_plain(name)},,1,{_UNITS.get(unit, _plain(unit))}"
        for number, (name, unit) in enumerate(told, 1)
    )
    content = {
        "name": " ".join(stream.header.name.split()),
        "data": path.with_suffix(".eeg").name,
        "markers": path.with_suffix(".vmrk").name,
        "count": len(names),
        "interval": repr(1e6 / rate_hz),
        "kind": kind,
        "channels": channels,
    }
    write_text(path, _HEADER.format(**content))


def write_markers(path: Path, events: Iterable[tuple[int, int, str]]) -> None:
    """Write the marker file.

    Parameters
    ----------
    events
        Row, number of rows and text of each marker; rows count from 0.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    lines = "\n".join(_marker_lines(events))
    write_text(path, _MARKERS.format(data=path.with_suffix(".eeg").name, markers=lines))


def _marker_lines(events: Iterable[tuple[int, int, str]]) -> Iterator[str]:
    yield "Mk1=New Segment,,1,1,0,00000000000000000000"
    for number, (row, length, text) in enumerate(events, 2):
        yield f"Mk{number}=Comment,{_plain(text)},{row + 1},{length},0"


def _plain(text: str) -> str:
    clean = "".join(each if each.isprintable() else " " for each in text)
    return clean.replace(",", "\\1").strip()
