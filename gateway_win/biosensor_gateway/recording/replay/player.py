"""Sends the samples of all streams in time, from one thread."""

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

from biosensor_common.replay import Replay, recorded_source_id, replay_source_id
from biosensor_gateway.recording.contents.choice import Chosen, on_one_clock
from biosensor_gateway.recording.contents.opening import extent
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.replay.outlet import Block, PlayedOutlet
from biosensor_gateway.recording.replay.source import ReplayError, ReplayReason
from biosensor_gateway.recording.xdf.container import Damage

PACE_S = 0.002
"""What is due within this time is sent together, so that many streams cost no more than few."""
LAP_PAUSE_S = 1.0
"""Between the end and the next begin, by the clock of now: a gap, as between two recordings."""
# LSL sends from threads of its own, and drops what it has not sent when an outlet ends.
_LINGER_S = 1.0
_LEAD_S = 0.05
_LOOK_S = 0.05
BIN_S = 0.0001
_BINS = 100_000
# Folded together only now and then: a block has a sample or two.
_MOST_BLOCKS = 1024


@dataclass(frozen=True, slots=True)
class Order:
    """How to play.

    Attributes
    ----------
    speed
        Seconds of the recording in one second, above 0.
    loop
        Whether to begin again at the end, until stopped.
    waits
        Whether to wait until each stream has a receiver.
    as_original
        Whether streams keep their recorded source_ids.
    """

    speed: float = 1.0
    loop: bool = False
    waits: bool = False
    as_original: bool = False


@dataclass(frozen=True, slots=True)
class Progress:
    """Where the player is; times in seconds of the recording.

    Attributes
    ----------
    lap
        How often it has begun, 0 while it waits for receivers.
    received
        How many streams somebody receives.
    """

    lap: int
    position_s: float
    length_s: float
    sent: int
    received: int


class Player:
    """Plays what was chosen of an open recording.

    Parameters
    ----------
    chosen
        The recording must stay open.
    file_hash
        What tells this recording from others.

    Attributes
    ----------
    streams
        Those that are played, also such as hold nothing: a receiver may wait for them.
    left_out
        Those that are not played, for their stamps are on no LSL clock.
    lateness
        Of all samples that were sent.

    Raises
    ------
    ReplayError
        ``EMPTY``, if no stream holds a sample in the span of time.
    """

    def __init__(self, chosen: Chosen, order: Order, file_hash: str) -> None:
        chosen, self.left_out = on_one_clock(chosen)
        self._chosen, self._order = chosen, order
        self._file_hash = file_hash
        self.streams = chosen.streams
        first_s, last_s = extent(self.streams)
        self.begin_s = chosen.begin_s if math.isfinite(chosen.begin_s) else first_s
        self.end_s = min(chosen.end_s, last_s)
        if self.end_s < self.begin_s:
            raise self._empty()
        self.lateness = Lateness()
        self._outlets: dict[int, PlayedOutlet] = {}
        self._sent = self._lap = 0
        self._position_s = self.begin_s

    @property
    def damages(self) -> tuple[Damage, ...]:
        """What of the recording cannot be played."""
        return self._chosen.contents.damages

    @property
    def recorded_ids(self) -> list[str]:
        """source_ids of the streams when they were measured; some may be empty."""
        return [_recorded_id(each) for each in self.streams]

    @property
    def own_ids(self) -> list[str]:
        """source_ids of the streams as they are played."""
        recorded = self.recorded_ids
        if self._order.as_original:
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
        """Put all streams on the network; nothing is sent yet.

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
                speed=self._order.speed,
                start_s=self.begin_s,
            )
            self._outlets[stream.number] = PlayedOutlet(header, source_id, replay)

    def watch(self, tap: Callable[[str, NDArray[np.float64], NDArray[Any]], None]) -> None:
        """Have a function given what is sent, with the source_id it is sent under.

        Call it after `offer`; see `PlayedOutlet.tap`. It is called from the thread that plays.
        """
        for outlet, source_id in zip(self._outlets.values(), self.own_ids, strict=True):
            outlet.tap = partial(tap, source_id)

    def progress(self) -> Progress:
        """Return where it is; may be called from any thread."""
        return Progress(
            lap=self._lap,
            position_s=self._position_s - self.begin_s,
            length_s=self.end_s - self.begin_s,
            sent=self._sent,
            received=sum(each.has_receiver() for each in list(self._outlets.values())),
        )

    def run(self, stopping: threading.Event) -> None:
        """Play to the end, or until it is to stop; call it once, after `offer`.

        Raises
        ------
        RecordingError
            If the file cannot be read any more.
        ReplayError
            ``EMPTY``, if there was nothing to send.
        """
        while self._order.waits and not self._all_received():
            if stopping.wait(_LOOK_S):
                return
        tracks = self._tracks()
        start_s = pylsl.local_clock() + _LEAD_S
        while not stopping.is_set():
            self._lap += 1
            self._play(tracks, Timeline(start_s, self.begin_s, self._order.speed), stopping)
            if not (self._sent or stopping.is_set()):
                raise self._empty()
            if not self._order.loop:
                break
            tracks = self._tracks()
            start_s += (self.end_s - self.begin_s) / self._order.speed + LAP_PAUSE_S
        if self.progress().received:
            time.sleep(_LINGER_S)

    def _all_received(self) -> bool:
        return all(each.has_receiver() for each in self._outlets.values())

    def _empty(self) -> ReplayError:
        message = f"{self._chosen.contents.path} holds no sample that was asked for"
        return ReplayError(ReplayReason.EMPTY, message)

    def _tracks(self) -> list[Track]:
        return [
            Track(self._outlets[each.number], self._chosen.samples(each)) for each in self.streams
        ]

    def _play(self, tracks: Sequence[Track], timeline: Timeline, stopping: threading.Event) -> None:
        # The number tells tracks apart that are due at the same time.
        due = [(each.due_s, number) for number, each in enumerate(tracks)]
        heapq.heapify(due)
        while due and due[0][0] < math.inf and not stopping.is_set():
            until_s = timeline.recorded(pylsl.local_clock())
            self._position_s = min(max(until_s, self.begin_s), self.end_s)
            while due[0][0] <= until_s and not stopping.is_set():
                number = due[0][1]
                stamps = tracks[number].send(until_s, timeline)
                self._sent += len(stamps)
                # What a device had told long before goes first, at once.
                self.lateness.add(pylsl.local_clock(), stamps, timeline.start_s)
                heapq.heapreplace(due, (tracks[number].due_s, number))
            wait_s = (due[0][0] - until_s) / timeline.speed
            time.sleep(min(max(wait_s, PACE_S), _LOOK_S))
        if not stopping.is_set():
            self._position_s = self.end_s


def _recorded_id(stream: Stream) -> str:
    return recorded_source_id(stream.header.source_id, stream.header.replay)


class Lateness:
    """A histogram of 0.1 ms, so that hours of samples take no more memory than a second."""

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS, np.int64)
        self._blocks: list[tuple[float, float, NDArray[np.float64]]] = []
        self._most_s = 0.0

    def add(self, sent_s: float, stamps: NDArray[np.float64], since_s: float = -math.inf) -> None:
        """Take in samples.

        Parameters
        ----------
        sent_s
            LSL time at which they had been given to LSL.
        stamps : ndarray of float64, shape (n_samples,)
        since_s
            What is stamped before that was late by intent, and is not counted.
        """
        self._blocks.append((sent_s, since_s, stamps))
        if len(self._blocks) >= _MOST_BLOCKS:
            self._fold()

    @property
    def most_s(self) -> float:
        """How late the latest sample was."""
        self._fold()
        return self._most_s

    def percentile_s(self, percent: float) -> float:
        """Return within which time so many of the samples were sent; 0 if there are none."""
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
    """Reads a stream chunk by chunk, the next one as soon as the last one has been sent.

    Parameters
    ----------
    blocks
        Its samples in the order of the file.

    Attributes
    ----------
    due_s
        When its next sample was recorded, infinite after the last. One whose stamp runs back
        goes out with the one before it.

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
        self.due_s = -math.inf
        self._read()

    def send(self, until_s: float, timeline: Timeline) -> NDArray[np.float64]:
        """Send what is due of the present chunk.

        Parameters
        ----------
        until_s
            Time of the recording, from `due_s` on.

        Returns
        -------
        ndarray of float64, shape (n_samples,)
            Stamps of what was sent.
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
        # From the chunk before on, so that a chunk that begins earlier goes out at once.
        due = np.maximum.accumulate(np.maximum(self._samples.times, self.due_s))
        # Asked for one by one, numbers of Python are three times as fast as those of numpy.
        self._due = due.tolist()
        self.due_s = self._due[0]


@dataclass(frozen=True, slots=True)
class Timeline:
    """``stamp = start + (time - begin) / speed``.

    Attributes
    ----------
    start_s
        LSL time, now, at which the recording's `begin_s` is played.
    begin_s
        LSL time on the clock of the computer that recorded.
    speed
        Seconds of the recording in one second, above 0.
    """

    start_s: float
    begin_s: float
    speed: float

    def stamps(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return when samples are played.

        Parameters
        ----------
        times : ndarray of float64, shape (n_samples,)
            When they were recorded.
        """
        return self.start_s + (times - self.begin_s) / self.speed

    def recorded(self, lsl_s: float) -> float:
        """Return the time of the recording that is played at an LSL time."""
        return self.begin_s + (lsl_s - self.start_s) * self.speed
