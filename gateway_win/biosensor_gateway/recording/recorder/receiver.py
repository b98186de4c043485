"""The process that records in the place of LabRecorder's program.

It is given a file and a predicate, looks for streams, prints a line for each that it finds and
has opened, and records until a line comes in or its input ends. What does not answer at once is
asked again and again, and recorded from then on. Exit codes: 0, 1 with a sentence
if the file cannot be written, 2 if there is no stream.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import BinaryIO

import pylsl

from biosensor_common.ending import end_within
from biosensor_common.errors import SpecError
from biosensor_common.heap import limit_arenas
from biosensor_common.lsl.namesakes import by_start
from biosensor_common.lsl.network import Streams, search
from biosensor_common.lsl.sender_clocks import LIMIT_S, STEP_S, SenderClocks
from biosensor_gateway.recording.receiving import NOTE
from biosensor_gateway.recording.receiving.stream import ReceivedStream
from biosensor_gateway.recording.xdf import writing

TAKE_EVERY_S = 0.02
"""What liblsl has and nobody has taken is gone with the outlet that sent it."""
FLUSH_EVERY_S = 0.5
BOUNDARY_EVERY_S = 10.0
_QUIET_S, _LONGEST_S = 2.0, 10.0
"""It looks until no other stream has come for so long, and for so long at most."""
_OPEN_S = 8.0
_OPENED_AT_ONCE = 32
_LAST_S = 0.2
"""What was sent right before the end is still on its way."""
_UNWRITABLE, _NO_STREAM = 1, 2


def record_streams(file: Path, predicate: str) -> int:
    """Record the streams that fit to a file; return the exit code of this process."""
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
    # liblsl closes its inlets one after the other, some of them only when their sender answers.
    end_within()
    return code


def _configure() -> None:
    """Take the settings from the file that is named: liblsl would lose letters of its name."""
    named = os.environ.get("LSLAPICFG")
    if named:
        pylsl.set_config_content(Path(named).read_text("utf-8"))


def _read_line(over: threading.Event) -> None:
    # Unbuffered: a thread that reads from a buffer cannot be left behind at the end.
    os.read(sys.stdin.fileno(), 1)
    over.set()


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
        # Of streams that have come back with other channels.
        self._renewed: list[pylsl.StreamInfo] = []

    def run(self, over: threading.Event) -> int:
        try:
            return self._run(over)
        finally:
            # Threads that open streams may come a moment later.
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
        writing.begin(self._target, datetime.now().astimezone().isoformat(timespec="seconds"), ())
        # All headers come first: readers know by them what is in a file that grows.
        for each in ready:
            each.begin()
        _say("Starting the recording")
        for each in ready:
            _say(f"Started data collection for stream {each.title}")
        # As often as LabRecorder does.
        clocks = SenderClocks(lambda: self._streams)
        try:
            self._record(over)
            self._wait_for_clocks()
        finally:
            clocks.stop()
        for each in self._streams:
            each.end()
            if not each.has_begun:
                _say(f"{NOTE}{each.title} never answered, and is not recorded")
        self._flush()
        return 0

    def _record(self, over: threading.Event) -> None:
        marked_s = flushed_s = time.monotonic()
        # As every resolver of the program it sees streams of the own session alone.
        resolver = pylsl.ContinuousResolver(pred=self._predicate)
        while not over.wait(TAKE_EVERY_S):
            self._take()
            if time.monotonic() - flushed_s >= FLUSH_EVERY_S:
                flushed_s = time.monotonic()
                self._flush()
                self._look_for_absent(resolver)
            if time.monotonic() - marked_s >= BOUNDARY_EVERY_S:
                marked_s = time.monotonic()
                self._write(writing.boundary())
        self._take()
        time.sleep(_LAST_S)
        self._take()

    def _wait_for_clocks(self) -> None:
        """Have even a recording of a moment one measurement of each clock, if senders answer."""
        end_s = time.monotonic() + LIMIT_S
        while time.monotonic() < end_s and any(
            each.is_ready and each.correction is None for each in self._streams
        ):
            time.sleep(STEP_S)

    def _look_for_absent(self, resolver: pylsl.ContinuousResolver) -> None:
        """Go on with streams that did not answer, and with those that were started again."""
        # First: whoever is done has noted before what is renewed.
        self._opening = {each: one for each, one in self._opening.items() if not one[1].done()}
        while self._renewed:
            again = ReceivedStream(next(self._numbers), self._renewed.pop(), self._write)
            self._streams.append(again)
            what = "has other channels than before, and is recorded as another stream"
            _say(f"{NOTE}{again.title} {what}")
        absent = [each for each in self._streams if not each.is_open and each not in self._opening]
        infos = sorted(resolver.results(), key=by_start) if absent else []
        for stream in absent:
            # Of two live senders that claim to be one stream, each is recorded by itself.
            taken = {each.uid for each in self._streams if each is not stream}
            taken |= {uid for uid, _ in self._opening.values()}
            fits = [e for e in infos if e.uid() not in taken and stream.goes_on_as(e)]
            if fits:
                # The one that has gone is announced for some seconds more.
                opening = self._pool.submit(self._open_again, stream, fits[-1])
                self._opening[stream] = fits[-1].uid(), opening

    def _open_again(self, stream: ReceivedStream, info: pylsl.StreamInfo) -> None:
        # If it does not answer, it is tried again.
        with suppress(RuntimeError):
            if not stream.open(info, _OPEN_S):
                self._renewed.append(info)
            elif stream.has_begun:
                _say(f"{stream.title} goes on")

    def _found(self) -> list[pylsl.StreamInfo]:
        """Look for streams; of many, on a busy computer, some answer late."""
        known, newest_s = 0, 0.0

        def is_enough(found: Streams, elapsed_s: float) -> bool:
            nonlocal known, newest_s
            if len(found) > known:
                known, newest_s = len(found), elapsed_s
            return elapsed_s >= min(newest_s + _QUIET_S, _LONGEST_S)

        return search(is_enough, self._predicate)

    def _open(self, number: int, info: pylsl.StreamInfo) -> ReceivedStream | None:
        """Open a stream; return None if it cannot be recorded. It may answer only later."""
        try:
            stream = ReceivedStream(number, info, self._write)
        except SpecError as error:
            _say(f"{info.name()} cannot be recorded: {error}")
            return None
        try:
            stream.open(info, _OPEN_S)
        except RuntimeError as error:
            _say(f"{info.name()} cannot be opened yet: {error}")
        return stream

    def _take(self) -> None:
        for each in self._streams:
            if each.is_open and not each.has_begun:
                each.begin()
                _say(f"Started data collection for stream {each.title}, later than others")
                _say(f"{NOTE}{each.title} is recorded only from {time.strftime('%H:%M:%S')} on")
            if (gone := each.take()) is not None:
                note = NOTE if gone else ""
                _say(f"{note}{each.title} has ended; {gone} of its samples were not received")

    def _flush(self) -> None:
        """Whoever watches the file sees it grow, and what was written outlives this process."""
        with self._lock:
            self._target.flush()

    def _write(self, chunk: bytes) -> None:
        with self._lock:
            if not self._is_over:
                self._target.write(chunk)
