"""Receives LSL streams and records them to an XDF file, in place of LabRecorder's program.

The process gets a file and a predicate, searches for streams, prints a line for each stream found
and opened, and records until it reads a line or its input ends. It retries streams that do not
answer and records them from then on. Exit codes: 0, 1 with a sentence if the file cannot be
written, 2 if there is no stream.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from itertools import count
from pathlib import Path
from time import monotonic
from typing import Any, BinaryIO, cast

import numpy as np
import pylsl
from numpy.typing import NDArray
from pylsl import util
from pylsl.lib import lib

from biosensor_common.errors import SpecError
from biosensor_common.lsl.header import read_core
from biosensor_common.lsl.inlet import (
    LAST_ENTRY_S,
    buffer_length,
    open_inlet,
    read_description,
    undelivered,
    unopened_inlet,
)
from biosensor_common.lsl.network import Network, Streams, search
from biosensor_common.lsl.sender_clocks import LIMIT_S, PERIOD_S, STEP_S, SenderClocks
from biosensor_common.process_limits import end_within, limit_arenas
from biosensor_common.quantities import ChannelFormat
from biosensor_gateway.recording.recorder.programs import NOTE
from biosensor_gateway.recording.xdf import chunks
from biosensor_gateway.recording.xdf.container import ChunkError
from biosensor_gateway.recording.xdf.header import parse_stream_header

_BUFFER_S = 360
# Maximum number of values per pull, and size of the buffer for liblsl.
_MOST_VALUES = 1 << 18


class ReceivedStream:
    """One recorded stream, over all of its successive outlets.

    Parameters
    ----------
    write
        Appends a chunk to the file; called from any thread.

    Attributes
    ----------
    first, last
        Timestamps of the first and last sample, 0 without samples.
    is_open
        Whether it is being received; False until its outlet answers and after it has closed.
        Another outlet may continue the stream.

    Raises
    ------
    SpecError
        If the stream's properties are invalid.
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
        # Pairs of LSL time on the sender's clock and offset to this computer's clock, in s.
        self.clock_offsets: list[tuple[float, float]] = []

    @property
    def title(self) -> str:
        """Its name in LabRecorder's output."""
        return f"{self._core.name}@{self._core.hostname}"

    @property
    def is_recordable(self) -> bool:
        """Whether samples and footer are written; like LabRecorder, not for int64."""
        return self._core.format is not ChannelFormat.INT64

    @property
    def is_ready(self) -> bool:
        """Whether its sender's clock can be measured."""
        return self.is_recordable and self.has_begun and self.is_open

    @property
    def correction(self) -> float | None:
        """The last measured offset of its sender's clock, in s; None before the first one."""
        return self.clock_offsets[-1][1] if self.clock_offsets else None

    def open(self, info: pylsl.StreamInfo, limit_s: float) -> bool:
        """Open an inlet, which buffers what the outlet sends from now on.

        LabRecorder's inlets reconnect to another outlet automatically, whatever its header says.

        Returns
        -------
        bool
            False if its channels differ from those in the recorded header, so its samples would be
            misread; then it is not received.

        Raises
        ------
        RuntimeError
            ``TimeoutError`` or ``LostError`` of pylsl: the sender does not answer.
        """
        length = buffer_length(self._core.rate, _BUFFER_S)
        inlet = open_inlet(info, limit_s, length, as_numpy=True)
        described = read_description(inlet, info.uid(), limit_s)
        # Read as bytes, because another program's header may not be UTF-8.
        xml = cast("bytes", lib.lsl_get_xml(described.obj))
        if self._xml and _channels(self._xml) != _channels(xml):
            return False
        self._xml = self._xml or xml
        self._inlet, self._info, self.uid = inlet, info, info.uid()
        self.is_open = True
        return True

    def goes_on_as(self, info: pylsl.StreamInfo) -> bool:
        """Whether *info* belongs to its outlet, or to a restarted one with the same format."""
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
        self._write(chunks.stream_header(self._number, self._xml))
        self.has_begun = True

    def take(self) -> int | None:
        """Write the samples received.

        Returns
        -------
        int or None
            Number of samples lost with a closed outlet, returned once, shortly after it closed;
            None otherwise.
        """
        while self.is_recordable and self.is_open:
            inlet = cast("pylsl.StreamInlet", self._inlet)
            # Not more than available: at the end of a lost stream, a larger pull would lose the
            # rest.
            waiting = max(1, inlet.samples_available())
            try:
                pulled = inlet.pull_chunk(0.0, min(waiting, self._most))
            # nothing is dropped: what the outlet took with it is counted below
            except util.LostError:
                self.is_open, self._lost = False, (inlet, monotonic())
                break
            values, stamps = cast("tuple[NDArray[Any], NDArray[np.float64]]", pulled)
            if not len(stamps):
                break
            is_text = self._core.format is ChannelFormat.STRING
            rows = [tuple(each) for each in values] if is_text else values
            self._write(chunks.samples(self._number, self._core.format, stamps, rows))
            if not self.sample_count:
                self.first = float(stamps[0])
            self.last = float(stamps[-1])
            self.sample_count += len(stamps)
        if self._lost is None or monotonic() - self._lost[1] < LAST_ENTRY_S:
            return None  # nothing is dropped: it is not over yet
        (inlet, _), self._lost = self._lost, None
        return undelivered(inlet)

    def end(self) -> None:
        """Write the footer, which must be the last chunk."""
        if self.is_recordable and self.has_begun:
            self._write(chunks.footer(self._number, self))

    def open_clock(self) -> pylsl.StreamInlet:
        """Return an inlet for one measurement of the sender's clock.

        Raises
        ------
        RuntimeError
            If liblsl cannot open one.
        """
        return unopened_inlet(self._info)

    def take_correction(self, correction: float) -> None:
        """Write a measured offset of the sender's clock."""
        taken_at = pylsl.local_clock() - correction
        self.clock_offsets.append((taken_at, correction))
        self._write(chunks.clock_offset(self._number, taken_at, correction))

    def repeat_correction(self) -> None:
        """Write the last offset once more while there is no new one, as LabRecorder does.

        By that a file shows how long a sender was away.
        """
        if self.clock_offsets:
            last_s = sum(self.clock_offsets[-1])
            if pylsl.local_clock() - last_s > 1.5 * PERIOD_S:
                self.take_correction(self.clock_offsets[-1][1])


def _channels(xml: bytes) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
    """Return the labels and units of a header; None if it cannot be read."""
    try:
        header = parse_stream_header(xml)
    except ChunkError:  # nothing is dropped: its numbers tell which channel is which
        return None  # nothing is dropped: its numbers tell which channel is which
    return header.labels, header.units


TAKE_EVERY_S = 0.02
"""Samples still buffered in liblsl are lost when their outlet closes."""
FLUSH_EVERY_S = 0.5
BOUNDARY_EVERY_S = 10.0
# The search ends when no new stream was found for this long, or after this time.
_QUIET_S, _LONGEST_S = 2.0, 10.0
_OPEN_S = 8.0
_OPENED_AT_ONCE = 32
# Time for samples that were sent right before the end and have not arrived yet.
_LAST_S = 0.2
_UNWRITABLE, _NO_STREAM = 1, 2


def record_streams(file: Path, predicate: str) -> int:
    """Record the matching streams to a file; return the exit code of this process."""
    limit_arenas(os.environ)
    _configure()
    over = threading.Event()
    threading.Thread(target=_read_line, args=[over], daemon=True).start()
    try:
        with file.open("wb") as target:
            code = _Recorder(target, predicate).run(over)
    except OSError as error:
        _say(f"{file} cannot be written: {error.strerror or error}")
        code = _UNWRITABLE
    # liblsl closes its inlets one by one, and some only when their sender answers.
    end_within()
    return code


def _configure() -> None:
    """Pass on the content of the LSL settings file, because liblsl may garble its path."""
    named = os.environ.get("LSLAPICFG")
    if named:
        pylsl.set_config_content(Path(named).read_text("utf-8"))


def _read_line(over: threading.Event) -> None:
    # Unbuffered, because a thread that holds a buffer's lock blocks the exit of the process.
    os.read(sys.stdin.fileno(), 1)
    over.set()


def _note(line: str) -> None:
    """Print a note for the check of the recording."""
    _say(NOTE + line)  # nothing is dropped: it is what reports


def _say(line: str) -> None:
    sys.stdout.buffer.write(f"{line}\n".encode(errors="replace"))
    sys.stdout.buffer.flush()


class _Recorder:
    def __init__(self, target: BinaryIO, predicate: str) -> None:
        self._target, self._predicate = target, predicate
        self._lock, self._is_over = threading.Lock(), False
        self._pool = ThreadPoolExecutor(_OPENED_AT_ONCE)
        self._streams: list[ReceivedStream] = []
        self._opening: dict[ReceivedStream, tuple[str, Future[None]]] = {}
        self._numbers = count(1)
        # Streams that came back with other channels.
        self._renewed: list[pylsl.StreamInfo] = []

    def run(self, over: threading.Event) -> int:
        try:
            return self._run(over)
        finally:
            # Threads that open streams may still finish afterwards.
            with self._lock:
                self._is_over = True

    def _run(self, over: threading.Event) -> int:
        found = self._found()
        opened = self._pool.map(self._open, self._numbers, found)
        self._streams = [each for each in opened if each is not None]
        ready = [each for each in self._streams if each.is_open]
        for each in ready:
            _say(f"Found {each.title} matching '{self._predicate}'")
        if not ready:
            return _NO_STREAM
        chunks.begin(self._target, datetime.now().astimezone().isoformat(timespec="seconds"), ())
        # Headers first: readers of a growing file take the list of streams from them.
        for each in ready:
            each.begin()
        _say("Starting the recording")
        for each in ready:
            _say(f"Started data collection for stream {each.title}")
        # At the same interval as LabRecorder.
        clocks = SenderClocks(lambda: self._streams)
        try:
            self._record(over)
            self._wait_for_clocks()
        finally:
            clocks.stop()
        for each in self._streams:
            each.end()
            if not each.has_begun:
                _note(f"{each.title} never answered, and is not recorded")
        self._flush()
        return 0

    def _record(self, over: threading.Event) -> None:
        marked_s = flushed_s = time.monotonic()
        # Like every resolver here, it only finds streams of this LSL session.
        network = Network(self._predicate)
        while not over.wait(TAKE_EVERY_S):
            self._take()
            if time.monotonic() - flushed_s >= FLUSH_EVERY_S:
                flushed_s = time.monotonic()
                self._flush()
                self._look_for_absent(network)
                for each in self._streams:
                    each.repeat_correction()
            if time.monotonic() - marked_s >= BOUNDARY_EVERY_S:
                marked_s = time.monotonic()
                self._write(chunks.boundary())
        self._take()
        time.sleep(_LAST_S)
        self._take()

    def _wait_for_clocks(self) -> None:
        """Wait for one measurement of each clock, so that even a short recording has one."""
        end_s = time.monotonic() + LIMIT_S
        while time.monotonic() < end_s and any(
            each.is_ready and each.correction is None for each in self._streams
        ):
            time.sleep(STEP_S)

    def _look_for_absent(self, network: Network) -> None:
        """Retry streams that did not answer, and reconnect to restarted ones."""
        # First, because finished tasks have already added to the renewed streams.
        self._opening = {each: one for each, one in self._opening.items() if not one[1].done()}
        while self._renewed:
            again = ReceivedStream(next(self._numbers), self._renewed.pop(), self._write)
            self._streams.append(again)
            what = "has different channels now, and is recorded as another stream"
            _note(f"{again.title} {what}")
        absent = [each for each in self._streams if not each.is_open and each not in self._opening]
        infos = network.streams() if absent else []
        for stream in absent:
            # If two running senders claim to be the same stream, each is recorded separately.
            taken = {each.uid for each in self._streams if each is not stream}
            taken |= {uid for uid, _ in self._opening.values()}
            fits = [e for e in infos if e.uid() not in taken and stream.goes_on_as(e)]
            if fits:
                # A closed outlet is still announced for some seconds; the newest one comes last.
                opening = self._pool.submit(self._open_again, stream, fits[-1])
                self._opening[stream] = fits[-1].uid(), opening

    def _open_again(self, stream: ReceivedStream, info: pylsl.StreamInfo) -> None:
        # If it does not answer, it is retried.
        with suppress(RuntimeError):  # nothing is dropped: if it does not answer, it is tried again
            if not stream.open(info, _OPEN_S):
                self._renewed.append(info)
            elif stream.has_begun:
                _say(f"{stream.title} goes on")  # nothing is dropped: it goes on

    def _found(self) -> list[pylsl.StreamInfo]:
        """Search for streams; on a busy computer some answer late."""
        known, newest_s = 0, 0.0

        def is_enough(found: Streams, elapsed_s: float) -> bool:
            nonlocal known, newest_s
            if len(found) > known:
                known, newest_s = len(found), elapsed_s
            return elapsed_s >= min(newest_s + _QUIET_S, _LONGEST_S)

        return search(is_enough, self._predicate)

    def _open(self, number: int, info: pylsl.StreamInfo) -> ReceivedStream | None:
        """Add a stream and try to open it; return None if it cannot be recorded at all."""
        try:
            stream = ReceivedStream(number, info, self._write)
        except SpecError as error:
            # nothing is dropped: who asked for it is told that it did not begin
            _say(f"{info.name()} cannot be recorded: {error}")
            return None  # nothing is dropped: who asked is told that it did not begin
        try:
            stream.open(info, _OPEN_S)
        except RuntimeError as error:
            # nothing is dropped: it is tried again while others are recorded
            _say(f"{info.name()} cannot be opened yet: {error}")
        return stream

    def _take(self) -> None:
        for each in self._streams:
            if each.is_open and not each.has_begun:
                each.begin()
                # nothing is dropped: it is received from its outlet's buffer
                _say(f"Started data collection for stream {each.title}, later than others")
                _note(f"{each.title} is recorded only from {time.strftime('%H:%M:%S')}")
            if (gone := each.take()) is not None:
                tell = _note if gone else _say
                tell(f"{each.title} has ended; {gone} of its samples were not received")

    def _flush(self) -> None:
        """Flush, so that others see the file grow and a crash loses nothing written."""
        with self._lock:
            self._target.flush()

    def _write(self, chunk: bytes) -> None:
        with self._lock:
            if not self._is_over:
                self._target.write(chunk)
