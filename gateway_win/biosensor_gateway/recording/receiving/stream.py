"""Receives one stream and turns it into chunks of an XDF file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import monotonic
from typing import Any, cast

import numpy as np
import pylsl
from numpy.typing import NDArray
from pylsl import util
from pylsl.lib import lib

from biosensor_common.errors import SpecError
from biosensor_common.lsl.announcements import read_core
from biosensor_common.lsl.inlets import (
    LAST_ENTRY_S,
    buffer_length,
    open_inlet,
    read_description,
    undelivered,
    unopened_inlet,
)
from biosensor_common.quantities import ChannelFormat
from biosensor_gateway.recording.xdf import writing
from biosensor_gateway.recording.xdf.container import ChunkError
from biosensor_gateway.recording.xdf.header import parse_stream_header

_BUFFER_S = 360
_MOST_VALUES = 1 << 18
"""Of one pull; liblsl is given room for so many."""


class ReceivedStream:
    """One stream that is recorded, over all outlets that it has one after the other.

    Parameters
    ----------
    number
        Its number in the file.
    info
        As a resolver gave it.
    write
        Appends a chunk to the file; from any thread.

    Attributes
    ----------
    first, last
        Stamps of the first and the last sample, 0 without samples.
    uid
        Of its newest outlet.
    is_open
        Whether it is received; False until its outlet answers, and once it has gone. Another
        outlet may go on with it.
    has_begun
        Whether its header is in the file.
    clock_offsets
        LSL time on the sender's clock, and what to add to get this computer's, in s.

    Raises
    ------
    SpecError
        If what it announces is no stream that can be recorded.
    """

    def __init__(
        self, number: int, info: pylsl.StreamInfo, write: Callable[[bytes], object]
    ) -> None:
        self._core = read_core(info)
        self._number, self._write, self._info = number, write, info
        self._inlet: pylsl.StreamInlet | None = None
        self._lost: tuple[pylsl.StreamInlet, float] | None = None
        self.uid, self.is_open, self.has_begun = info.uid(), False, False
        self._most = max(1, _MOST_VALUES // self._core.channel_count)
        self._xml = b""
        self.first = self.last = 0.0
        self.sample_count = 0
        self.clock_offsets: list[tuple[float, float]] = []

    @property
    def title(self) -> str:
        """As LabRecorder names it."""
        return f"{self._core.name}@{self._core.hostname}"

    @property
    def is_recordable(self) -> bool:
        """Whether samples and footer are written; LabRecorder keeps only the header of int64."""
        return self._core.format is not ChannelFormat.INT64

    @property
    def is_ready(self) -> bool:
        """Whether its sender's clock is to be measured."""
        return self.is_recordable and self.has_begun and self.is_open

    @property
    def correction(self) -> float | None:
        """What was measured last of its sender's clock, in s; None before the first time."""
        return self.clock_offsets[-1][1] if self.clock_offsets else None

    def open(self, info: pylsl.StreamInfo, limit_s: float) -> bool:
        """Have liblsl keep what an outlet sends from now on.

        LabRecorder's inlets go on with another outlet by themselves, whatever its header says.

        Returns
        -------
        bool
            False if it is not received: its channels are not those of the header that was read
            first, so that its samples would be taken for something else.

        Raises
        ------
        RuntimeError
            ``TimeoutError`` or ``LostError`` of pylsl: the sender does not answer.
        """
        length = buffer_length(self._core.rate, _BUFFER_S)
        inlet = open_inlet(info, limit_s, length, as_numpy=True)
        described = read_description(inlet, info.uid(), limit_s)
        # The bytes as they came: a header of another program may be no UTF-8.
        xml = cast("bytes", lib.lsl_get_xml(described.obj))
        if self._xml and _channels(self._xml) != _channels(xml):
            return False
        self._xml = self._xml or xml
        self._inlet, self._info, self.uid = inlet, info, info.uid()
        self.is_open = True
        return True

    def goes_on_as(self, info: pylsl.StreamInfo) -> bool:
        """Whether *info* is of its outlet, or of one that was started again with the same shape."""
        if info.uid() == self.uid:
            return True
        core = self._core
        try:
            other = read_core(info)
        except SpecError:
            return False
        return bool(core.source_id) and replace(other, hostname=core.hostname) == core

    def begin(self) -> None:
        """Write the header."""
        self._write(writing.stream_header(self._number, self._xml))
        self.has_begun = True

    def take(self) -> int | None:
        """Write what has come.

        Returns
        -------
        int or None
            A moment after its outlet has gone, once: how many samples went with it. None
            otherwise.
        """
        while self.is_recordable and self.is_open:
            inlet = cast("pylsl.StreamInlet", self._inlet)
            # No more than there are: at the end of a lost stream liblsl throws away the rest.
            waiting = max(1, inlet.samples_available())
            try:
                pulled = inlet.pull_chunk(0.0, min(waiting, self._most))
            except util.LostError:
                self.is_open, self._lost = False, (inlet, monotonic())
                break
            values, stamps = cast("tuple[NDArray[Any], NDArray[np.float64]]", pulled)
            if not len(stamps):
                break
            is_text = self._core.format is ChannelFormat.STRING
            rows = [tuple(each) for each in values] if is_text else values
            self._write(writing.samples(self._number, self._core.format, stamps, rows))
            if not self.sample_count:
                self.first = float(stamps[0])
            self.last = float(stamps[-1])
            self.sample_count += len(stamps)
        if self._lost is None or monotonic() - self._lost[1] < LAST_ENTRY_S:
            return None
        (inlet, _), self._lost = self._lost, None
        return undelivered(inlet)

    def end(self) -> None:
        """Write the footer; nothing is written after it."""
        if self.is_recordable and self.has_begun:
            self._write(writing.footer(self._number, self))

    def open_clock(self) -> pylsl.StreamInlet:
        """Open an inlet for one measurement of the sender's clock.

        Raises
        ------
        RuntimeError
            If liblsl can open none.
        """
        return unopened_inlet(self._info)

    def take_correction(self, correction: float) -> None:
        """Write a measurement of the sender's clock."""
        taken_at = pylsl.local_clock() - correction
        self.clock_offsets.append((taken_at, correction))
        self._write(writing.clock_offset(self._number, taken_at, correction))


def _channels(xml: bytes) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
    """Return the labels and units of a header; None if it cannot be read."""
    try:
        header = parse_stream_header(xml)
    except ChunkError:
        return None
    return header.labels, header.units
