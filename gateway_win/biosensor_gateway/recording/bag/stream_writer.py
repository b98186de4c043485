"""Writes one stream of an XDF file: collects samples into chunks and adds clock offsets."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biosensor_common.quantities import ChannelFormat
from biosensor_gateway.recording.xdf import writing
from biosensor_gateway.recording.xdf.samples import Texts
from biosensor_gateway.recording.xdf.sender_clock import SenderClock

OFFSETS_EVERY_S = 5.0
"""LabRecorder measures clocks at this interval."""

# A longer gap means that the clock jumped, so it is not filled with offsets.
_LONGEST_SILENCE_S = 3600.0
# Chunks must be large enough for fast reading and small enough for memory.
_CHUNK_S, _MOST_PENDING = 1.0, 512
_DTYPES = {
    ChannelFormat.FLOAT32: np.float32,
    ChannelFormat.DOUBLE64: np.float64,
    ChannelFormat.INT64: np.int64,
    ChannelFormat.INT32: np.int32,
    ChannelFormat.INT16: np.int16,
    ChannelFormat.INT8: np.int8,
}


class StreamWriter:
    """Writes one stream.

    Parameters
    ----------
    write
        Appends a chunk to the file.
    number
        Number of the stream in the file.
    xml
        Its header.
    form, channels
        As in the header.
    clock_offsets
        Measured pairs of LSL time on the stream's clock and offset to the file's clock, in s. None
        for a stream on the file's clock: then an offset of 0 is written every five seconds,
        because loaders complain without offsets.

    Attributes
    ----------
    first, last
        Timestamps of the first and last sample, 0 without samples.
    clock_offsets
        Those written to the file.
    """

    def __init__(
        self,
        write: Callable[[bytes], object],
        number: int,
        xml: str,
        form: ChannelFormat,
        channels: int,
        clock_offsets: Sequence[tuple[float, float]] | None = None,
    ) -> None:
        self._write = write
        self.number = number
        self._form, self._channels = form, channels
        self._due = None if clock_offsets is None else list(reversed(clock_offsets))
        self._clock = SenderClock(clock_offsets or ())
        self._times: list[NDArray[np.float64]] = []
        self._values: list[Any] = []
        self.first = self.last = 0.0
        self.sample_count = 0
        self.clock_offsets: list[tuple[float, float]] = []
        write(writing.stream_header(number, xml))

    def add(self, times: NDArray[np.float64], values: NDArray[Any] | Texts) -> None:
        """Add samples.

        Parameters
        ----------
        times : ndarray of float64, shape (n,)
            Finite, on the file's clock.
        values : ndarray, shape (n, n_channels), or list of tuple
        """
        if not len(times):
            return
        self._times.append(times)
        if isinstance(values, list):
            self._values.extend(values)
        else:
            self._values.append(values)
        if len(self._times) >= _MOST_PENDING or times[-1] - self._times[0][0] >= _CHUNK_S:
            self.flush()

    def flush(self) -> None:
        """Write the pending samples, after the clock offsets up to their time."""
        if not self._times:
            return
        times = np.concatenate(self._times)
        if self._form is ChannelFormat.STRING:
            values: Any = self._values
        else:
            with np.errstate(invalid="ignore", over="ignore"):
                values = np.concatenate(self._values).astype(_DTYPES[self._form], copy=False)
        for part in self._clock.parts(times):
            self._write_part(times[part], values[part])
        self._times, self._values = [], []

    def _write_part(self, times: NDArray[np.float64], values: NDArray[Any] | Texts) -> None:
        self._tell_clock(float(times.min()), float(times.max()))
        stamps = self._clock.to_sender(times)
        if not self.sample_count:
            self.first = float(stamps[0])
        self.last = float(stamps[-1])
        self.sample_count += len(stamps)
        self._write(writing.samples(self.number, self._form, stamps, values))

    def end(self) -> None:
        """Write the remaining samples and the footer."""
        self.flush()
        if self._due is not None:
            self._tell_clock(0.0, math.inf)
        self._write(writing.footer(self.number, self))

    def _tell_clock(self, first: float, until: float) -> None:
        if self._due is not None:
            while self._due and sum(self._due[-1]) <= until:
                self._tell(*self._due.pop())
            return
        if not self.clock_offsets:
            self._tell(first, 0.0)
        told = self.clock_offsets[-1][0]
        if until - told > _LONGEST_SILENCE_S:
            self._tell(until, 0.0)
        while (told := self.clock_offsets[-1][0] + OFFSETS_EVERY_S) <= until:
            self._tell(told, 0.0)

    def _tell(self, taken_at: float, offset: float) -> None:
        self.clock_offsets.append((taken_at, offset))
        self._write(writing.clock_offset(self.number, taken_at, offset))
