"""Receives one stream and turns it into chunks of an XDF file."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pylsl
from numpy.typing import NDArray
from pylsl import util
from pylsl.lib import lib

from biosensor_common.announcements import read_core
from biosensor_common.errors import SpecError
from biosensor_common.lsl.inlets import read_description, unopened_inlet
from biosensor_common.quantities import ChannelFormat
from biosensor_gateway.recording.xdf import writing

OFFSETS_EVERY_S = 5.0
_BUFFER_S = 360
_MEASURE_S = 2.0
_MOST_VALUES = 1 << 18
"""Of one pull; liblsl is given room for so many."""
_END_S = 1.0


class ReceivedStream:
    """One stream that is recorded.

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
    is_lost
        Whether its outlet has gone; another one may go on with it.
    clock_offsets
        LSL time on the sender's clock, and what to add to get this computer's, in s.

    Raises
    ------
    SpecError
        If what it announces is no stream that can be recorded.
    RuntimeError
        If liblsl cannot make an inlet.
    """

    def __init__(
        self, number: int, info: pylsl.StreamInfo, write: Callable[[bytes], object]
    ) -> None:
        self._core = read_core(info)
        self._number, self._write = number, write
        self._inlet = unopened_inlet(info, _BUFFER_S, as_numpy=True)
        self._uid, self.is_lost = info.uid(), False
        self._most = max(1, _MOST_VALUES // self._core.channel_count)
        self._xml = b""
        self._over = threading.Event()
        self._measuring = threading.Thread(target=self._measure, daemon=True)
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

    def open(self, limit_s: float) -> None:
        """Have liblsl keep what is sent from now on, and ask for the header.

        Raises
        ------
        RuntimeError
            ``TimeoutError`` or ``LostError`` of pylsl: the sender does not answer.
        """
        self._inlet.open_stream(limit_s)
        info = read_description(self._inlet, self._uid, limit_s)
        # The bytes as they came: a header of another program may be no UTF-8.
        self._xml = cast("bytes", lib.lsl_get_xml(info.obj))

    def goes_on_as(self, info: pylsl.StreamInfo) -> bool:
        """Whether *info* is of the outlet of this stream, started again with the same shape."""
        core = self._core
        try:
            other = read_core(info)
        except SpecError:
            return False
        return bool(core.source_id) and replace(other, hostname=core.hostname) == core

    def follow(self, info: pylsl.StreamInfo, limit_s: float) -> None:
        """Go on with another outlet, which LabRecorder's inlets do by themselves.

        Raises
        ------
        RuntimeError
            As `open`.
        """
        inlet = unopened_inlet(info, _BUFFER_S, as_numpy=True)
        inlet.open_stream(limit_s)
        self._inlet, self._uid, self.is_lost = inlet, info.uid(), False

    def begin(self) -> None:
        """Write the header, and measure the sender's clock from now on."""
        self._write(writing.stream_header(self._number, self._xml))
        if self.is_recordable:
            self._measuring.start()

    def take(self) -> int | None:
        """Write what has come.

        Returns
        -------
        int or None
            When its outlet has gone: how many samples went with it. None otherwise.
        """
        while self.is_recordable and not self.is_lost:
            # No more than there are: at the end of a lost stream liblsl throws away the rest.
            waiting = max(1, self._inlet.samples_available())
            try:
                pulled = self._inlet.pull_chunk(0.0, min(waiting, self._most))
            except util.LostError:
                self.is_lost = True
                return self._inlet.flush()
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
        return None

    def end(self) -> None:
        """Write the footer; nothing is written after it."""
        if self.is_recordable:
            self._over.set()
            self._measuring.join(_MEASURE_S + _END_S)
            self._write(writing.footer(self._number, self))

    def _measure(self) -> None:
        while not self._over.is_set():
            try:
                offset = self._inlet.time_correction(_MEASURE_S)
            except RuntimeError:
                # The sender does not answer; the next one may come through.
                offset = None
            if offset is not None and not self._over.is_set():
                taken_at = pylsl.local_clock() - offset
                self.clock_offsets.append((taken_at, offset))
                self._write(writing.clock_offset(self._number, taken_at, offset))
            self._over.wait(OFFSETS_EVERY_S)
