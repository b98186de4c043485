"""Sends the samples of all streams on time, from one thread."""

from __future__ import annotations

import heapq
import math
import threading
import time
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pylsl
from numpy.typing import NDArray

from biosensor_common.stream_header import Replay, recorded_source_id, replay_source_id
from biosensor_gateway.recording.contents.choice import Chosen, on_one_clock
from biosensor_gateway.recording.contents.contents import extent
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.replay.source import ReplayError, ReplayReason
from biosensor_gateway.recording.replay.stream_outlet import Block, PlayedOutlet
from biosensor_gateway.recording.xdf.container import Damage

PACE_S = 0.002
"""Samples due within this time are sent together, so many streams cost little more than few."""
LAP_PAUSE_S = 1.0
"""Pause between two rounds in real time, like the gap between two recordings."""
# LSL sends from its own threads, and drops unsent samples when an outlet closes.
_LINGER_S = 1.0
_LEAD_S = 0.05
_LOOK_S = 0.05
BIN_S = 0.0001
_BINS = 100_000
# Blocks of one or two samples are added to the histogram in groups, which is faster.
_MOST_BLOCKS = 1024


@dataclass(frozen=True, slots=True)
class PlayOptions:
    """How to play."""

    speed: float = 1.0  # Seconds of the recording per second, above 0.
    loop: bool = False
    waits: bool = False
    as_original: bool = False


@dataclass(frozen=True, slots=True)
class Progress:
    """Progress of the player; times in seconds of the recording."""

    lap: int  # Number of rounds started, 0 while it waits for receivers.
    position_s: float
    length_s: float
    sent: int
    received: int  # Number of streams with a receiver.


class Player:
    """Plays a selection from an open recording.

    Parameters
    ----------
    chosen
        Selection from a recording that must stay open.

    Attributes
    ----------
    left_out
        Streams that are not played, because they are not on an LSL clock.

    Raises
    ------
    ReplayError
        ``EMPTY``, if no stream has samples in the time range.
    """

    def __init__(self, chosen: Chosen, options: PlayOptions, file_hash: str) -> None:
        chosen, self.left_out = on_one_clock(chosen)
        self._chosen, self._options = chosen, options
        self._file_hash = file_hash
        # Streams to play, including empty ones, because a receiver may wait for them.
        self.streams = chosen.streams
        span = extent(self.streams)
        self.begin_s = chosen.begin_s if math.isfinite(chosen.begin_s) else span.begin
        self.end_s = min(chosen.end_s, span.end)
        if self.end_s < self.begin_s:
            raise self._empty()
        self.lateness = Lateness()
        self._outlets: dict[int, PlayedOutlet] = {}
        self._sent = self._lap = 0
        self._position_s = self.begin_s

    @property
    def is_whole(self) -> bool:
        """Whether all samples of the selected streams can be read and are played."""
        is_left_out = any(each.untimed or each.part_error for each in self.streams)
        return not (self.damages or self.left_out or is_left_out)

    @property
    def damages(self) -> tuple[Damage, ...]:
        """Parts of the recording that cannot be played."""
        return self._chosen.contents.damages

    @property
    def recorded_ids(self) -> list[str]:
        """source_ids of the streams when they were recorded; some may be empty."""
        return [_recorded_id(each) for each in self.streams]

    @property
    def own_ids(self) -> list[str]:
        """source_ids of the played streams."""
        recorded = self.recorded_ids
        if self._options.as_original:
            return recorded
        several = Counter(_recorded_id(each) for each in self._chosen.contents.streams)
        return [
            replay_source_id(
                self._file_hash,
                known if known and several[known] == 1 else f"{known}#{stream.number}",
            )
            for stream, known in zip(self.streams, recorded, strict=True)
        ]

    def offer(self) -> None:
        """Offer all streams on the network, without sending samples yet.

        Raises
        ------
        ReplayError
            ``NO_OUTLET``, if LSL cannot offer one.
        """
        for stream, source_id in zip(self.streams, self.own_ids, strict=True):
            header = stream.header
            replay = Replay(
                file=self._chosen.contents.path.name,
                source_id=_recorded_id(stream),
                rate=header.rate,
                speed=self._options.speed,
                start_s=self.begin_s,
            )
            self._outlets[stream.number] = PlayedOutlet(header, source_id, replay)

    def watch(self, tap: Callable[[str, NDArray[np.float64], NDArray[Any]], None]) -> None:
        """Set a callback for the samples sent, with their source_id.

        Call this after `offer`. The callback runs in the playing thread; see `PlayedOutlet.tap`.
        """
        for outlet, source_id in zip(self._outlets.values(), self.own_ids, strict=True):
            outlet.tap = partial(tap, source_id)

    def progress(self) -> Progress:
        """Return the progress; may be called from any thread."""
        return Progress(
            lap=self._lap,
            position_s=self._position_s - self.begin_s,
            length_s=self.end_s - self.begin_s,
            sent=self._sent,
            received=sum(each.has_receiver() for each in list(self._outlets.values())),
        )

    def run(self, stopping: threading.Event) -> None:
        """Play to the end, or until `stopping` is set; call it once, after `offer`.

        Raises
        ------
        RecordingError
            If the file cannot be read any more.
        ReplayError
            ``EMPTY``, if there was nothing to send.
        """
        while self._options.waits and not self._all_received():
            if stopping.wait(_LOOK_S):
                return
        tracks = self._tracks()
        start_s = pylsl.local_clock() + _LEAD_S
        while not stopping.is_set():
            self._lap += 1
            self._play(tracks, Timeline(start_s, self.begin_s, self._options.speed), stopping)
            if not (self._sent or stopping.is_set()):
                raise self._empty()
            if not self._options.loop:
                break
            tracks = self._tracks()
            start_s += (self.end_s - self.begin_s) / self._options.speed + LAP_PAUSE_S
        if self.progress().received:
            time.sleep(_LINGER_S)

    def _all_received(self) -> bool:
        return all(each.has_receiver() for each in self._outlets.values())

    def _empty(self) -> ReplayError:
        message = f"{self._chosen.contents.path} has no samples in the selection"
        return ReplayError(ReplayReason.EMPTY, message)

    def _tracks(self) -> list[Track]:
        return [Track(self._outlets[each.number], self.samples(each)) for each in self.streams]

    def samples(self, stream: Stream) -> Iterator[Samples]:
        """Yield the samples of a stream that are played."""
        # The time of a single stamp from the future would never come, and others wait behind it.
        for samples in self._chosen.samples(stream, as_recorded=bool(stream.part_error)):
            # Those of another clock would be due in years.
            if len(kept := stream.on_clock(samples)):
                yield kept

    def _play(self, tracks: Sequence[Track], timeline: Timeline, stopping: threading.Event) -> None:
        # The number breaks ties between tracks due at the same time.
        due = [(each.due_s, number) for number, each in enumerate(tracks)]
        heapq.heapify(due)
        while due and due[0][0] < math.inf and not stopping.is_set():
            until_s = timeline.recorded(pylsl.local_clock())
            self._position_s = min(max(until_s, self.begin_s), self.end_s)
            while due[0][0] <= until_s and not stopping.is_set():
                number = due[0][1]
                stamps = tracks[number].send(until_s, timeline)
                self._sent += len(stamps)
                # Samples older than the recording, such as a device's state, are sent first.
                self.lateness.add(pylsl.local_clock(), stamps, timeline.start_s)
                heapq.heapreplace(due, (tracks[number].due_s, number))
            wait_s = (due[0][0] - until_s) / timeline.speed
            time.sleep(min(max(wait_s, PACE_S), _LOOK_S))
        if not stopping.is_set():
            self._position_s = self.end_s


def _recorded_id(stream: Stream) -> str:
    return recorded_source_id(stream.header.source_id, stream.header.replay)


class Lateness:
    """A histogram in steps of 0.1 ms, whose memory does not grow with the recording."""

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS, np.int64)
        self._blocks: list[tuple[float, float, NDArray[np.float64]]] = []
        self._most_s = 0.0

    def add(self, sent_s: float, stamps: NDArray[np.float64], since_s: float = -math.inf) -> None:
        """Add samples.

        Parameters
        ----------
        sent_s
            LSL time at which they had been passed to LSL.
        stamps : ndarray of float64, shape (n_samples,)
        since_s
            Samples with earlier timestamps are late on purpose and not counted.
        """
        self._blocks.append((sent_s, since_s, stamps))
        if len(self._blocks) >= _MOST_BLOCKS:
            self._fold()

    @property
    def most_s(self) -> float:
        """The largest lateness of a sample."""
        self._fold()
        return self._most_s

    def percentile_s(self, percent: float) -> float:
        """Return a percentile of the lateness; 0 without samples."""
        self._fold()
        sums: NDArray[np.int64] = np.cumsum(self._counts)
        if not sums[-1]:
            return 0.0
        wanted = int(sums[-1]) * percent / 100
        return (int(np.count_nonzero(sums < wanted)) + 1) * BIN_S

    def _fold(self) -> None:
        if not self._blocks:
            return
        sent, since, blocks = zip(*self._blocks, strict=True)
        lengths = [len(each) for each in blocks]
        stamps: NDArray[np.float64] = np.concatenate(blocks)
        late = (np.repeat(sent, lengths) - stamps)[stamps >= np.repeat(since, lengths)]
        self._blocks.clear()
        self._most_s = max(self._most_s, float(late.max(initial=0.0)))
        bins = np.clip(late / BIN_S, 0, _BINS - 1).astype(np.int64)
        np.add.at(self._counts, bins, 1)


class Track:
    """Reads a stream chunk by chunk, each as soon as the previous one was sent.

    Parameters
    ----------
    blocks
        Its samples in the order of the file.

    Raises
    ------
    RecordingError
        If the file cannot be read any more, here and in `send`.
    """

    def __init__(self, outlet: PlayedOutlet, blocks: Iterator[Samples]) -> None:
        self._outlet, self._blocks = outlet, blocks
        self._samples: Samples | None = None
        self._block: Block | None = None
        self._stamps = np.empty(0)
        self._due: list[float] = []
        self._at = 0
        # Time of its next sample in the recording, infinite after the last. A sample with an
        # earlier timestamp than the previous one is sent together with it.
        self.due_s = -math.inf
        self._read()

    def send(self, until_s: float, timeline: Timeline) -> NDArray[np.float64]:
        """Send the samples of the current chunk that are due.

        Parameters
        ----------
        until_s
            Time in the recording, at least `due_s`.

        Returns
        -------
        ndarray of float64, shape (n_samples,)
            Timestamps of the samples sent.
        """
        if self._samples is None:
            return np.empty(0)
        if self._block is None:
            self._stamps = timeline.stamps(self._samples.times)
            self._block = self._outlet.block(self._samples, self._stamps)
        begin, end = self._at, bisect_right(self._due, until_s, self._at)
        self._block.push(begin, end)
        stamps = self._stamps[begin:end]
        self._at = end
        if end < len(self._due):
            self.due_s = self._due[end]
        else:
            self._read()
        return stamps

    def _read(self) -> None:
        self._samples, self._block, self._at = next(self._blocks, None), None, 0
        if self._samples is None:
            self.due_s = math.inf
            return
        # Not before the previous chunk, so that an earlier chunk is sent at once.
        due = np.maximum.accumulate(np.maximum(self._samples.times, self.due_s))
        # Accessed one by one, Python floats are three times as fast as numpy scalars.
        self._due = due.tolist()
        self.due_s = self._due[0]


@dataclass(frozen=True, slots=True)
class Timeline:
    """``stamp = start + (time - begin) / speed``."""

    start_s: float  # Current LSL time at which the recording's `begin_s` is played.
    begin_s: float  # LSL time on the recorder's clock.
    speed: float  # Seconds of the recording per second, above 0.

    def stamps(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the LSL times at which samples are played.

        Parameters
        ----------
        times : ndarray of float64, shape (n_samples,)
            Their times in the recording.
        """
        return self.start_s + (times - self.begin_s) / self.speed

    def recorded(self, lsl_s: float) -> float:
        """Return the time in the recording that is played at an LSL time."""
        return self.begin_s + (lsl_s - self.start_s) * self.speed
