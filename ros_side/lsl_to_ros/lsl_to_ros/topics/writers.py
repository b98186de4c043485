"""Writes samples as messages: one writer for each kind of topic."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

from numpy.typing import NDArray

from biosensor_common.naming import TopicName
from biosensor_common.quantities import MessageType
from biosensor_common.refusal import Refusal
from biosensor_common.refusals import Refusals
from biosensor_common.stream_header import StreamHeader
from lsl_to_ros.accounts.counters import Lost
from lsl_to_ros.accounts.stamping import Stamping
from lsl_to_ros.lsl.blocks import Run
from lsl_to_ros.topics import cdr, messages
from lsl_to_ros.topics.chunker import Chunker
from lsl_to_ros.topics.publishers import TopicPublisher


class StreamContext(NamedTuple):
    """What the writers of one stream share.

    Attributes
    ----------
    frame_id
        The sensor, with participant and label: what its topics have between prefix and data.
    """

    header: StreamHeader
    topic: TopicName
    frame_id: str
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
    """One message of numbers a sample, without a stamp."""

    def __init__(
        self,
        publisher: TopicPublisher,
        message_type: MessageType,
        channels: int,
        refusals: Refusals,
    ) -> None:
        super().__init__(publisher)
        self._type = message_type
        self._limits = message_type.integer_range
        self._encode = cdr.SampleEncoder(message_type, channels).encode
        self._refuse = refusals.refuse

    def write(self, run: Run) -> None:
        """Publish each sample; those beyond an integer message's range are refused alone."""
        samples = run.samples
        if self._limits is not None:
            samples = self._fitting(samples, *self._limits)
        self.publisher.publish(*self._encode(samples))

    def _fitting(self, samples: NDArray[Any], low: int, high: int) -> NDArray[Any]:
        fits = ((samples >= low) & (samples <= high)).all(axis=1)
        if fits.all():
            return samples
        value = samples[~fits][0, 0]
        why = f"{value} does not fit into {self._type}"
        self._refuse(Refusal.UNFIT, int((~fits).sum()), why=why)
        return samples[fits]


class TextWriter(Writer):
    """One message of text a sample, or one that only says that it came."""

    def __init__(self, publisher: TopicPublisher, message_type: MessageType) -> None:
        super().__init__(publisher)
        self._build = messages.text_builder(message_type)

    def write(self, run: Run) -> None:
        """Publish each sample."""
        for sample in run.samples:
            self.publisher.publish(self._build(sample))


class ChunkWriter:
    """Collects samples whether or not somebody reads, so that no reader breaks a chunk."""

    def __init__(self, publisher: TopicPublisher, message_type: MessageType, channels: int) -> None:
        self.publisher = publisher
        self._type = message_type
        self._channels = channels
        self._dtype = cdr.wire_dtype(message_type)
        self._chunker = Chunker(channels * self._dtype.itemsize)

    def add(self, samples: NDArray[Any], length: int) -> None:
        """Add samples of shape [samples, channels]; publish the chunks that they fill."""
        for chunk in self._chunker.add(cdr.to_bytes(samples, self._dtype), length):
            if self.publisher.is_wanted:
                self.publisher.publish(cdr.chunk_message(self._type, chunk, self._channels))

    def discard(self) -> int:
        """Give up the partial chunk; return its samples."""
        return self._chunker.discard()
