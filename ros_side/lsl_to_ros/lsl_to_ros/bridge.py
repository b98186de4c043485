"""One LSL stream and the ROS topics that it fills."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Any, Protocol

from biosensor_common.stream_header import StreamHeader
from lsl_to_ros import messages
from lsl_to_ros.chunker import Chunker
from lsl_to_ros.losses import LossAccount
from lsl_to_ros.parameters import StreamSettings

# Two samples whose stamps are further apart than this many periods are not neighbours.
GAP_PERIODS = 1.5


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

    Attributes
    ----------
    received
        Samples received since the bridge was made.
    missing
        Samples that did not come, estimated from the stamps of a regular stream.
    unfit
        Samples that do not fit the message type, and were not published.
    last_stamp
        Newest stamp, on the sender's LSL clock.
    """

    def __init__(
        self,
        header: StreamHeader,
        raw: Topic,
        chunk: Topic | None,
        settings: StreamSettings,
        account: LossAccount,
        to_time: messages.ToTime,
        warn: Callable[[str], None],
        listen: Callable[[str], None] | None = None,
    ) -> None:
        self.header = header
        self.settings = settings
        self.account = account
        self.received = 0
        self.missing = 0
        self.unfit = 0
        self.last_stamp = 0.0
        self._raw, self._chunk = raw, chunk
        self._warn = warn
        self._listen = listen
        channels = len(header.labels)
        self._build = messages.builder(header.message_type, channels, to_time)
        self._chunk_type = messages.chunk_type(header.message_type)
        self.chunker = Chunker(channels, messages.typecode(self._chunk_type))
        self._longest_step = GAP_PERIODS / header.rate if header.rate > 0 else float("inf")

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
        settings = self.settings
        if self.received and stamp - self.last_stamp > self._longest_step:
            self.missing += round((stamp - self.last_stamp) * self.header.rate) - 1
            self.chunker.discard()
        self.received += 1
        self.last_stamp = stamp
        self.account.pulled(stamp)
        if self._listen is not None:
            self._listen(sample[0])
        if settings.raw and self._raw.get_subscription_count():
            self._publish(sample, stamp)
        if self._chunk is not None:
            self._add_to_chunk(self._chunk, sample, settings)

    def _publish(self, sample: list[Any], stamp: float) -> None:
        try:
            message = self._build(sample, stamp)
        except (ValueError, OverflowError) as error:
            if not self.unfit:
                name = f"{self.header.identity.sensor} {self.header.data_name}"
                self._warn(f"{name}: a sample is not published ({error})")
            self.unfit += 1
        else:
            self._raw.publish(message)

    def _add_to_chunk(self, topic: Topic, sample: list[Any], settings: StreamSettings) -> None:
        if not settings.chunk:
            self.chunker.discard()
            return
        for values in self.chunker.add(sample, settings.chunk_length):
            self._publish_chunk(topic, values)

    def _publish_chunk(self, topic: Topic, values: array[float]) -> None:
        if topic.get_subscription_count():
            channels = len(self.header.labels)
            topic.publish(messages.chunk_message(self._chunk_type, values, channels))
