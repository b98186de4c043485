"""Publishes one LSL stream on its ROS topics."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biosensor_common.lsl.inlet import Block, local_clock
from biosensor_common.refusal import Refusal
from biosensor_common.stream_header import StreamHeader
from lsl_to_ros.parameters.streams import StreamSettings
from lsl_to_ros.statistics.losses import Gap, GapFinder, NodeCounters
from lsl_to_ros.statistics.ros_time import Stamping
from lsl_to_ros.topics.publishers import TopicPublisher
from lsl_to_ros.topics.writers import ChunkWriter, Run, Writer, part, split

# Limit of the runs that wait for the measurement of the sender's clock, which takes 0.7 s.
HELD_RUNS = 10_000


@dataclass(slots=True)
class Outputs:
    """Writers and publishers of a stream."""

    raw: Writer | None = None  # Writer without stamps; None if the raw message has a stamp.
    # Writers that need the time of a sample.
    timed: list[Writer] = field(default_factory=list[Writer])
    chunk: ChunkWriter | None = None  # Writer of chunks; None for a stream without chunks.
    # Transforms the samples for `raw` and `chunk`; None if they get them unchanged.
    shape: Callable[[Run], Run] | None = None

    @property
    def of_samples(self) -> list[Writer]:
        """All writers of single samples; the raw one comes first, because it never waits."""
        return [*([self.raw] if self.raw else []), *self.timed]

    @property
    def publishers(self) -> list[TopicPublisher]:
        """All publishers."""
        chunk = [self.chunk.publisher] if self.chunk else []
        return [*(writer.publisher for writer in self.of_samples), *chunk]


class Bridge:
    """Publishes the samples of one stream; a :class:`~lsl_to_ros.lsl.inlets.Receiver`.

    Its methods are called by whichever thread reads the stream, one at a time.

    Parameters
    ----------
    counters
        Counters, whose refusals get reports of data that cannot be published.
    """

    def __init__(
        self,
        header: StreamHeader,
        outputs: Outputs,
        settings: StreamSettings,
        counters: NodeCounters,
        stamping: Stamping,
        listen: Callable[[Block], None] | None = None,
    ) -> None:
        self.header = header
        self.outputs = outputs
        self.settings = settings
        self.counters = counters
        # Values of the newest sample of an irregular stream, None before the first.
        self.newest: NDArray[Any] | None = None
        self._stamping = stamping
        self._refuse = counters.refusals.refuse
        self._listen = listen
        self._is_counted_by_agent = not header.foreign
        self._keeps_newest = header.rate == 0 and not header.message_type.is_text
        self._gaps = GapFinder(header.rate, foreign=header.foreign)
        # nothing is dropped: `_hold` reports what is given up
        self._held: deque[Run] = deque(maxlen=HELD_RUNS)
        self._shaping = threading.Lock()
        # Asked for with each block of samples.
        self._publishers = outputs.publishers
        self._of_samples = [writer.publisher for writer in outputs.of_samples]
        self._lanes = [publisher.lane for publisher in self._publishers]

    @property
    def last_stamp(self) -> float:
        """Newest stamp, on the sender's LSL clock; 0 before the first."""
        return self._gaps.last_stamp

    @property
    def has_unix_stamps(self) -> bool:
        """Whether the sender stamps with Unix time instead of LSL's."""
        return self._stamping.is_unix

    def age_s(self, now_s: float) -> float:
        """Return the age of the newest sample, at a time on this machine's LSL clock."""
        stamping, stamp = self._stamping, self.last_stamp
        return now_s - (stamping.local(stamp) if stamping.is_known else stamp)

    @property
    def readers(self) -> int:
        """Number of subscribers of all its topics."""
        return sum(publisher.readers for publisher in self._publishers)

    @property
    def waiting(self) -> int:
        """Number of paced messages of its topics that are not published yet."""
        return sum(publisher.lane.waiting for publisher in self._publishers)

    @property
    def oldest_waiting_s(self) -> float:
        """Return for how many seconds the oldest of these has waited."""
        return max((publisher.lane.age_s for publisher in self._publishers), default=0.0)

    @property
    def wants_each_sample(self) -> bool:
        """Whether single samples have subscribers; else they can be drained in batches."""
        if self._listen is not None:
            return True
        return self.settings.raw and any(publisher.readers for publisher in self._of_samples)

    @property
    def is_full(self) -> bool:
        """Whether its backlog is so large that LSL should buffer the rest."""
        # A loop, because a generator takes longer than the checks themselves.
        for lane in self._lanes:  # noqa: SIM110
            if lane.is_full:
                return True
        return False

    def receive(self, block: Block) -> None:
        """Publish samples and the chunks that they fill."""
        sequence = self.counters.received
        self.counters.received += len(block.stamps)
        if self._is_counted_by_agent:
            self.counters.comparison.pulled(block.stamps.tolist())
        if self._keeps_newest:
            self.newest = block.samples[-1].copy()
        if self._listen is not None:
            self._listen(block)
        gaps = self._gaps.find(block.stamps)
        if gaps:
            self._write_around(gaps, block, sequence)
        else:
            self._write(Run(block.samples, block.stamps, sequence))
        if self._stamping.is_known:
            self.counters.delays.add(local_clock() - self._stamping.local(self.last_stamp))

    def clock_known(self) -> None:
        """Write the samples that waited for the sender's clock."""
        while self._held:
            self._write_timed(self._held.popleft())

    def end(self, undelivered: int) -> None:
        """Give up incomplete chunks, because the next samples follow a gap."""
        self.counters.connection_ended(undelivered)
        if self._held:
            self._refuse(Refusal.UNSTAMPED, sum(len(run.stamps) for run in self._held))
            self._held.clear()
        self._discard()

    def _write_around(self, gaps: Iterable[Gap], block: Block, sequence: int) -> None:
        start = 0
        for gap in gaps:
            self._write(part(block, start, gap.place, sequence))
            self.counters.missing += gap.missing
            self._discard()
            start = gap.place
        self._write(part(block, start, len(block.stamps), sequence))

    def more(self) -> None:
        """Write samples that are complete now; called by the thread with the missing part."""
        nothing = Run(np.empty((0, len(self.header.labels))), np.empty(0), 0)
        self._write_shaped(nothing, self.settings)

    def _write(self, run: Run) -> None:
        # Read once, because another thread may replace it at any time.
        settings = self.settings
        self._write_shaped(run, settings)
        if settings.raw:
            self._write_timed_or_hold(run)

    def _write_shaped(self, run: Run, settings: StreamSettings) -> None:
        shape = self.outputs.shape
        if shape is None:
            self._write_untimed(run, settings)
        else:
            with self._shaping:
                self._write_untimed(shape(run), settings)

    def _write_untimed(self, run: Run, settings: StreamSettings) -> None:
        outputs = self.outputs
        if settings.raw and outputs.raw is not None:
            self._publish(outputs.raw, run)
        if outputs.chunk is not None:
            if settings.chunk:
                outputs.chunk.add(run.samples, settings.chunk_length)
            else:
                self._discard()

    def _write_timed_or_hold(self, run: Run) -> None:
        outputs = self.outputs
        for writer in outputs.timed:
            if writer.publisher.is_wanted:
                break
        else:
            # nothing is dropped: nobody has subscribed
            return
        if self._held or not self._stamping.is_known:
            self._hold(run)
        else:
            self._write_timed(run)

    def _hold(self, run: Run) -> None:
        if len(self._held) == HELD_RUNS:
            self._refuse(Refusal.UNSTAMPED, len(self._held[0].stamps))
        # A view would keep the whole block in memory.
        self._held.append(Run(run.samples.copy(), run.stamps.copy(), run.sequence))

    def _write_timed(self, run: Run) -> None:
        fits = self._stamping.are_times(run.stamps)
        if not fits.all():
            why = f"a timestamp of {run.stamps[~fits][0]:g} s is not a time"
            self._refuse(Refusal.NO_TIME, int((~fits).sum()), why=why)
        # One text that cannot be decoded must not affect those that came with it.
        is_text = self.header.message_type.is_text
        for piece in split(run, fits, alone=is_text):
            for writer in self.outputs.timed:
                self._publish(writer, piece)

    def _publish(self, writer: Writer, run: Run) -> None:
        if writer.publisher.is_wanted and len(run.stamps):
            try:
                writer.write(run)
            except (OverflowError, TypeError, ValueError) as error:
                self._refuse(Refusal.UNFIT, len(run.stamps), why=error)

    def _discard(self) -> None:
        given_up = 0 if self.outputs.chunk is None else self.outputs.chunk.discard()
        if given_up:
            self._refuse(Refusal.CHUNK_CUT, given_up)
