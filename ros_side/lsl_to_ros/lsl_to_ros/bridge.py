"""One LSL stream and the ROS topics that it fills."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from biosensor_common.stream_header import StreamHeader
from lsl_to_ros import messages
from lsl_to_ros.chunker import Chunker
from lsl_to_ros.losses import LossAccount
from lsl_to_ros.parameters import StreamSettings

# Two samples whose stamps are further apart than this many periods are not neighbours.
GAP_PERIODS = 1.5
# Other programs often stamp with the time at which they push, so their stamps jitter.
FOREIGN_JITTER_S = 0.1


@dataclass(slots=True)
class Tally:
    """What became of one stream's samples; it outlives its bridges.

    Attributes
    ----------
    received
        Samples received.
    missing
        Samples that did not come, estimated from the stamps of a regular stream.
    unfit
        Samples that do not fit the message type, and were not published.
    discarded
        Samples of partial chunks that ended at a gap. They went out raw.
    """

    received: int = 0
    missing: int = 0
    unfit: int = 0
    discarded: int = 0


class Topic(Protocol):
    """What the bridge needs of an rclpy publisher."""

    @property
    def topic_name(self) -> str:
        """Full name of the topic."""
        ...

    def publish(self, msg: Any) -> None:  # noqa: ANN401 - any message
        """Send one message."""
        ...

    def get_subscription_count(self) -> int:
        """Count the matched subscribers."""
        ...


class Bridge:
    """Receives one stream's samples in its inlet's thread and publishes them there.

    Parameters
    ----------
    raw, chunk
        Publishers; *chunk* is None where the stream has no chunk topic.
    settings
        May be replaced at any time, as a whole; it holds from the next sample on.
    to_time
        Turns a stamp into a ROS time, for messages with a header.
    warn
        Called with a sentence for the first sample that does not fit its message.
    listen
        Gets the text of every sample, whether or not the topic has readers.
    latched
        A subscriber that comes later gets the last sample, so each is published.

    Attributes
    ----------
    last_stamp
        Newest stamp, on the sender's LSL clock; 0 before the first.
    """

    def __init__(
        self,
        header: StreamHeader,
        raw: Topic,
        chunk: Topic | None,
        settings: StreamSettings,
        account: LossAccount,
        tally: Tally,
        to_time: messages.ToTime,
        warn: Callable[[str], None],
        listen: Callable[[str], None] | None = None,
        *,
        latched: bool = False,
    ) -> None:
        self.header = header
        self.settings = settings
        self.account = account
        self.tally = tally
        self.last_stamp = 0.0
        self._raw, self._chunk = raw, chunk
        self._warn = warn
        self._listen = listen
        self._latched = latched
        channels = len(header.labels)
        self._build = messages.builder(header.message_type, channels, to_time)
        self._chunk_type = messages.chunk_type(header.message_type)
        self.chunker = Chunker(channels, messages.typecode(self._chunk_type))
        jitter = FOREIGN_JITTER_S if header.foreign else 0.0
        self._longest_step = max(GAP_PERIODS / header.rate, jitter) if header.rate > 0 else math.inf

    @property
    def received(self) -> int:
        """Samples received."""
        return self.tally.received

    @property
    def raw(self) -> Topic:
        """Publisher of single samples."""
        return self._raw

    @property
    def chunk(self) -> Topic | None:
        """Publisher of chunks, if the stream has any."""
        return self._chunk

    @property
    def wants_each_sample(self) -> bool:
        """Whether somebody reads single samples; else they can be drained in batches."""
        return self._listen is not None or (
            self.settings.raw and self._raw.get_subscription_count() > 0
        )

    def receive(self, sample: list[Any], stamp: float) -> None:
        """Publish one sample and the chunks that it fills."""
        self.tally.received += 1
        self._note(stamp)
        self.account.pulled(stamp)
        if self._listen is not None:
            self._listen(sample[0])
        try:
            self._publish(sample, stamp, self.settings)
        except (OverflowError, TypeError, ValueError) as error:
            self._refuse(error)

    def end(self) -> None:
        """Give up the partial chunk: what comes next, comes after a break."""
        self._discard()

    def _note(self, stamp: float) -> None:
        """Look for a gap before this stamp; the stamps of other programs may be anything."""
        step = stamp - self.last_stamp if self.last_stamp else 0.0
        if step > self._longest_step:
            periods = step * self.header.rate
            self.tally.missing += round(periods) - 1 if math.isfinite(periods) else 0
            self._discard()
        if math.isfinite(stamp):
            self.last_stamp = stamp

    def _discard(self) -> None:
        self.tally.discarded += self.chunker.discard()

    def _refuse(self, error: Exception) -> None:
        if not self.tally.unfit:
            name = f"{self.header.identity.sensor} {self.header.data_name}"
            self._warn(f"{name}: a sample is not published ({error})")
        self.tally.unfit += 1
        self._discard()

    def _publish(self, sample: list[Any], stamp: float, settings: StreamSettings) -> None:
        if settings.raw and (self._latched or self._raw.get_subscription_count()):
            self._raw.publish(self._build(sample, stamp))
        if self._chunk is not None:
            self._add_to_chunk(self._chunk, sample, settings)

    def _add_to_chunk(self, topic: Topic, sample: list[Any], settings: StreamSettings) -> None:
        if not settings.chunk:
            self._discard()
            return
        for values in self.chunker.add(sample, settings.chunk_length):
            self._publish_chunk(topic, values)

    def _publish_chunk(self, topic: Topic, values: array[float]) -> None:
        if topic.get_subscription_count():
            channels = len(self.header.labels)
            topic.publish(messages.chunk_message(self._chunk_type, values, channels))
