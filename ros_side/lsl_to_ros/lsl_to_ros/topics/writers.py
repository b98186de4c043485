"""Writes samples as messages: one writer for each kind of topic."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_common.lsl.inlet import Block, Stamps
from biosensor_common.naming import TopicName
from biosensor_common.quantities import MessageType
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.ros import messages
from biosensor_common.ros.messages import (
    RawNumbers,
    StampedNumbers,
    StampedTexts,
    counters_message,
    raw_text,
    text_of,
)
from biosensor_common.ros.standard_messages import StandardMessage
from biosensor_common.stream_header import StreamHeader
from lsl_to_ros.statistics.losses import Lost
from lsl_to_ros.statistics.ros_time import Stamping
from lsl_to_ros.topics.publishers import TopicPublisher


class Run(NamedTuple):
    """Consecutive samples of a block without a gap."""

    # samples, stamps: as in a block.
    samples: NDArray[Any]
    stamps: Stamps
    # Number of the first sample: how many of this stream the node received before it.
    sequence: int


def part(block: Block, start: int, end: int, sequence: int) -> Run:
    """Return samples *start* to *end* of a block whose first sample has this number."""
    return Run(block.samples[start:end], block.stamps[start:end], sequence + start)


def split(run: Run, chosen: NDArray[np.bool_], *, alone: bool) -> list[Run]:
    """Return the chosen samples as runs, each with consecutive numbers.

    Parameters
    ----------
    alone
        Whether each sample becomes a separate run.
    """
    if chosen.all() and not alone:
        return [run]
    places = np.flatnonzero(chosen)
    breaks = np.arange(1, len(places)) if alone else np.flatnonzero(np.diff(places) > 1) + 1
    block = Block(run.samples, run.stamps)
    groups = np.split(places, breaks) if len(places) else []
    return [part(block, int(group[0]), int(group[-1]) + 1, run.sequence) for group in groups]


class StreamContext(NamedTuple):
    """State shared by the writers of one stream."""

    header: StreamHeader
    topic: TopicName
    frame_id: str  # The sensor with participant and label, as in its topics.
    stamping: Stamping
    lost: Callable[[], Lost]
    refusals: Refusals


class Writer(ABC):
    """Publishes the samples of a stream on one topic."""

    def __init__(self, publisher: TopicPublisher) -> None:
        self.publisher = publisher

    @abstractmethod
    def write(self, run: Run) -> None:
        """Publish all samples of a run.

        Raises
        ------
        ValueError
            If one of them does not fit the message.
        """


class NumberWriter(Writer):
    """One message of numbers per sample, without a stamp."""

    def __init__(
        self,
        publisher: TopicPublisher,
        message_type: MessageType,
        channels: int,
        refusals: Refusals,
    ) -> None:
        super().__init__(publisher)
        self._type = message_type
        self._messages = RawNumbers(message_type, channels)
        self._refuse = refusals.refuse

    def write(self, run: Run) -> None:
        """Publish each sample; only those beyond an integer message's range are refused."""
        samples = run.samples
        fits = self._messages.fitting(samples)
        if fits is not None:
            why = f"{samples[~fits][0, 0]} does not fit into {self._type}"
            self._refuse(Refusal.UNFIT, int((~fits).sum()), why=why)
            samples = samples[fits]
        self.publisher.publish(*self._messages.encode(samples))


class TextWriter(Writer):
    """One message of text per sample, or an empty one."""

    def __init__(self, publisher: TopicPublisher, message_type: MessageType) -> None:
        super().__init__(publisher)
        self._type = message_type

    def write(self, run: Run) -> None:
        """Publish each sample."""
        for sample in run.samples:
            self.publisher.publish(raw_text(self._type, text_of(sample)))


class CountersWriter(Writer):
    """The agent's counters, whose message has a stamp itself."""

    def __init__(self, publisher: TopicPublisher, stamping: Stamping) -> None:
        super().__init__(publisher)
        self._stamping = stamping

    def write(self, run: Run) -> None:
        """Publish each report."""
        times = self._stamping.to_ns(run.stamps).tolist()
        for time_ns, sample in zip(times, run.samples, strict=True):
            self.publisher.publish(counters_message(time_ns, sample[0]))


class SamplesWriter(Writer):
    """``<data>_stamped`` of numbers: one message for the samples that came together."""

    def __init__(self, publisher: TopicPublisher, context: StreamContext) -> None:
        super().__init__(publisher)
        self._messages = StampedNumbers(context.header, context.frame_id)
        self._stamping, self._lost = context.stamping, context.lost

    def write(self, run: Run) -> None:
        """Publish a run as one message."""
        lost = self._lost()
        message = self._messages.encode(
            self._stamping.of_run(run.stamps),
            run.samples,
            run.sequence,
            lost.count,
            lost_is_estimated=lost.is_estimated,
        )
        self.publisher.publish(message)


class EventWriter(Writer):
    """``<data>_stamped`` of text: one message per sample."""

    def __init__(self, publisher: TopicPublisher, context: StreamContext) -> None:
        super().__init__(publisher)
        self._messages = StampedTexts(context.frame_id)
        self._stamping = context.stamping

    def write(self, run: Run) -> None:
        """Publish each event."""
        times = self._stamping.to_ns(run.stamps).tolist()
        for number, (time_ns, sample) in enumerate(zip(times, run.samples, strict=True)):
            message = self._messages.encode(time_ns, text_of(sample), run.sequence + number)
            self.publisher.publish(message)


class StandardMessageWriter(Writer):
    """One message of ``sensor_msgs`` per sample."""

    def __init__(
        self, publisher: TopicPublisher, messages: StandardMessage, stamping: Stamping
    ) -> None:
        super().__init__(publisher)
        self._messages, self._stamping = messages, stamping

    def write(self, run: Run) -> None:
        """Publish each sample."""
        times = self._stamping.of_run(run.stamps)
        self.publisher.publish(*self._messages.encode(times, run.samples))


class ChunkWriter:
    """Collects samples even without subscribers, so that a new one does not break a chunk."""

    def __init__(self, publisher: TopicPublisher, message_type: MessageType, channels: int) -> None:
        self.publisher = publisher
        self._type = message_type
        self._channels = channels
        self._dtype = messages.wire_dtype(message_type)
        self._chunker = Chunker(channels * self._dtype.itemsize)

    def add(self, samples: NDArray[Any], length: int) -> None:
        """Add samples of shape [samples, channels]; publish the chunks that they fill."""
        for chunk in self._chunker.add(messages.to_bytes(samples, self._dtype), length):
            if self.publisher.is_wanted:
                self.publisher.publish(messages.chunk_message(self._type, chunk, self._channels))

    def discard(self) -> int:
        """Discard the partial chunk; return its number of samples."""
        return self._chunker.discard()


class Chunker:
    """Cuts a stream into chunks; no sample is dropped or repeated by a change of length."""

    def __init__(self, sample_size: int) -> None:
        self._sample_size = sample_size
        self._values = bytearray()

    @property
    def pending(self) -> int:
        """Number of samples in the partial chunk."""
        return len(self._values) // self._sample_size

    def add(self, values: bytes, length: int) -> list[bytes]:
        """Add whole samples; return the chunks of *length* samples that are now full.

        Several can be full, after many samples or after the length was reduced. Values
        keep their order: row-major, shape [length, channels].
        """
        collected = self._values
        collected += values
        size = length * self._sample_size
        end = len(collected) - len(collected) % size
        if not end:
            # nothing is dropped: they wait for more
            return []
        full = [bytes(collected[start : start + size]) for start in range(0, end, size)]
        del collected[:end]
        return full

    def discard(self) -> int:
        """Discard the partial chunk, as no chunk spans a gap; return its number of samples."""
        discarded = self.pending
        self._values.clear()
        return discarded
