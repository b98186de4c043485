"""One stream of a recording that is being written: how far it has come."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.xdf.container import ChunkError
from biosensor_gateway.recording.xdf.header import RecordedHeader
from biosensor_gateway.recording.xdf.measuring import (
    MAX_STAMP_ERROR_S,
    MAX_UPTIME_S,
    find_gaps,
    is_exact,
)
from biosensor_gateway.recording.xdf.pace import Cuts
from biosensor_gateway.recording.xdf.samples import decode

_CLOCK_OFFSET = struct.Struct("<dd")
_SECTION_S, _FEWEST = 20.0, 64
"""So much of another program's stream is looked at together."""


@dataclass(frozen=True, slots=True)
class GrowingStream:
    """How far one stream has come, as plain values.

    Attributes
    ----------
    nominal_hz
        0 if it is irregular.
    newest_stamp
        Of its newest sample, on its own clock, in s; None without samples.
    age_s
        How long the file has had nothing new of it, by the newest that the file has of any
        stream; None without samples.
    clock_offsets
        How often its clock was compared with the recorder's.
    offset_age_s
        How long ago the last time was, by the newest that the file has; None without any.
    is_closed
        Whether the recorder has ended it.
    gaps, longest_gap_s
        Places where samples of a regular stream are missing, and the longest of them.
    """

    name: str
    source_id: str
    host: str
    nominal_hz: float
    samples: int
    newest_stamp: float | None
    age_s: float | None
    clock_offsets: int
    offset_age_s: float | None
    is_closed: bool
    gaps: int = 0
    longest_gap_s: float = 0.0


class StreamProgress:
    """Takes in the chunks of one stream; times are on the recorder's clock, in s.

    Attributes
    ----------
    reached
        How late it is by this stream; -inf if it does not tell.
    heard_at, measured_at
        How late it was by the whole file when its newest samples came, and its newest clock
        offset; None before the first.
    """

    def __init__(self, header: RecordedHeader) -> None:
        self.header = header
        self.reached = -math.inf
        self.heard_at: float | None = None
        self.measured_at: float | None = None
        self.samples = self.offsets = self.gaps = 0
        self.longest_gap_s = 0.0
        self.is_closed = False
        self._last_stamp = math.nan
        self._offset = 0.0
        # Stamps of others say little one by one, so they are looked at some time later.
        self._cuts: Cuts | None = None
        if header.is_regular and not is_exact(header):
            self._cuts = Cuts(header.rate, max(_FEWEST, math.ceil(_SECTION_S * header.rate)))

    @property
    def newest_stamp(self) -> float | None:
        """Stamp of the newest sample on the stream's own clock; None without a usable one."""
        return self._last_stamp if math.isfinite(self._last_stamp) else None

    def take_samples(self, content: memoryview) -> None:
        """Take in the content of a samples chunk.

        Raises
        ------
        ChunkError
            If it cannot be decoded; nothing of it is taken in then.
        """
        before = self._last_stamp if self.samples else 0.0
        stamps = decode(content, self.header, before).stamps
        self.samples += len(stamps)
        if len(stamps):
            self._find_gaps(stamps)
            self._last_stamp = float(stamps[-1])
            if self._is_on_the_lsl_clock():
                self.reached = max(self.reached, self._last_stamp + self._offset)

    def take_offset(self, content: memoryview) -> float | None:
        """Take in the content of a clock offset chunk; return the recorder's time in it.

        None if it was not measured: of an outlet that has just gone, LabRecorder notes that its
        clock stood at 0.

        Raises
        ------
        ChunkError
            If it makes no sense.
        """
        if len(content) != _CLOCK_OFFSET.size:
            raise ChunkError("it does not have the size of a clock offset")
        taken_at, offset = _CLOCK_OFFSET.unpack(content)
        if not (math.isfinite(taken_at) and math.isfinite(offset)):
            raise ChunkError("its times are no numbers")
        if not taken_at:
            return None
        self.offsets += 1
        self._offset = offset
        # It tells what time it really was, whatever the samples say.
        self.reached = taken_at + offset
        return self.reached

    def _find_gaps(self, stamps: NDArray[np.float64]) -> None:
        if self._cuts is not None:
            self._cuts.take(stamps[np.isfinite(stamps)])
            self.gaps = len(self._cuts.holes)
            self.longest_gap_s = max((each.length_s for each in self._cuts.holes), default=0.0)
            return
        run = np.concatenate(([self._last_stamp], stamps))
        gaps = find_gaps(run[np.isfinite(run)], self.header)
        self.gaps += gaps.count
        self.longest_gap_s = max(self.longest_gap_s, *(each.length_s for each in gaps.listed), 0.0)

    def _is_on_the_lsl_clock(self) -> bool:
        time = self._last_stamp + self._offset
        if self.offsets:
            # It was within some seconds before; a device that waited may be far behind.
            return time < self.reached + MAX_STAMP_ERROR_S
        made = self.header.created_at if math.isfinite(self.header.created_at) else 0.0
        return -MAX_STAMP_ERROR_S < self._last_stamp - made < MAX_UPTIME_S
