"""Writes BrainVision files, the form of EEG that BIDS recommends.

A header (``.vhdr``), the samples as they were recorded, one after the other (``.eeg``), and markers
(``.vmrk``), by the BrainVision Core Data Format 1.0. Values are never scaled: float32 and integers
of 16 bits are the recorded ones in every bit, other formats become the nearest float32.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from os import SEEK_END
from pathlib import Path
from typing import BinaryIO

import numpy as np

from biosensor_common.quantities import ChannelFormat
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.export.bids.tables import write_text

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
    """Writes samples as numbers, a row each.

    Parameters
    ----------
    file
        Open for writing and reading.
    is_small
        Whether the values are integers of 16 bits. These have no value that stands for none, so
        where one is needed all become float32, which has the same numbers.

    Attributes
    ----------
    kind
        The binary format of what is written.
    empty
        First row and count of the rows without samples.
    """

    def __init__(self, file: BinaryIO, *, is_small: bool) -> None:
        self._file = file
        self.kind = "INT_16" if is_small else "IEEE_FLOAT_32"
        self.rows = 0
        self.empty: list[tuple[int, int]] = []

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
        """Turn what is written into float32, from its end on."""
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
    """Whether the samples are integers of 16 bits at most."""
    return stream.header.format in (ChannelFormat.INT8, ChannelFormat.INT16)


def is_exact(stream: Stream) -> bool:
    """Whether the numbers are the recorded ones in every bit."""
    exact = (ChannelFormat.INT8, ChannelFormat.INT16, ChannelFormat.FLOAT32)
    return stream.header.format in exact


def write_header(
    path: Path, stream: Stream, names: Sequence[str], kind: str, rate_hz: float
) -> None:
    """Write the header beside the samples.

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
    """Write the markers beside the samples.

    Parameters
    ----------
    events
        Row, number of rows and text of each; rows count from 0.

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
