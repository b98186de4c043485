"""Opens the topics of a stream, with a writer for each."""

from __future__ import annotations

from collections.abc import Collection
from importlib import import_module
from types import ModuleType

from biosensor_common.quantities import MessageType
from biosensor_common.refusal import Refusal
from biosensor_common.topic_shape import chunk_type
from lsl_to_ros.accounts.stamping import Stamping
from lsl_to_ros.lsl.blocks import Run
from lsl_to_ros.topics import messages
from lsl_to_ros.topics.bridge import Outputs
from lsl_to_ros.topics.publishers import TopicPublisher, TopicPublishers, TopicTypeError
from lsl_to_ros.topics.standard_messages import STANDARD_MESSAGES
from lsl_to_ros.topics.writers import ChunkWriter, NumberWriter, StreamContext, TextWriter, Writer


def _stamped() -> ModuleType | None:
    try:
        return import_module("lsl_to_ros.topics.stamped")
    except ImportError:
        # nothing is dropped: the reports say that there are no stamped topics
        return None


_STAMPED = _stamped()
HAS_STAMPED_TOPICS = _STAMPED is not None
"""Whether the package ``biosensor_msgs`` has been built and can be imported."""


class CountersWriter(Writer):
    """The agent's counters, whose message has a stamp of its own."""

    def __init__(self, publisher: TopicPublisher, stamping: Stamping) -> None:
        super().__init__(publisher)
        self._stamping = stamping

    def write(self, run: Run) -> None:
        """Publish each report."""
        for sample, stamp in zip(run.samples, run.stamps, strict=True):
            time = self._stamping.to_time(float(stamp))
            self.publisher.publish(messages.counters_message(sample[0], time))


def open_outputs(
    publishers: TopicPublishers, context: StreamContext, used: Collection[TopicPublisher] = ()
) -> Outputs:
    """Open every topic of a stream: raw, stamped, those of ``sensor_msgs`` and chunks.

    Raises
    ------
    TopicTypeError
        If one of the topics is among the *used* ones and has another type.
    """
    header, topic = context.header, context.topic

    def opened(name: str, kind: type) -> TopicPublisher:
        # A late subscriber of a state sees the last value at once.
        latched = header.is_state
        return publishers.open(
            f"{topic.base}/{name}", kind, header.rate, latched=latched, used=used
        )

    raw = opened(topic.data, messages.CLASSES[header.message_type])
    if header.message_type is MessageType.DIAGNOSTIC_ARRAY:
        return Outputs(timed=[CountersWriter(raw, context.stamping)])
    outputs = Outputs(raw=_raw_writer(raw, context))
    if _STAMPED is not None:
        publisher = opened(f"{topic.data}_stamped", _STAMPED.message_class(header))
        outputs.timed.append(_STAMPED.writer(publisher, context))
    for standard in () if header.foreign else STANDARD_MESSAGES:
        if name := standard.topic_of(header):
            try:
                publisher = opened(name, standard.message_class)
            except TopicTypeError:
                # Another stream of the device has that name as its own.
                context.refusals.refuse(Refusal.NO_STANDARD_TOPIC, topic=f"{topic.base}/{name}")
                continue
            context.refusals.over(Refusal.NO_STANDARD_TOPIC)
            outputs.timed.append(standard(publisher, header, context.frame_id, context.stamping))
    if header.chunk:
        kind = chunk_type(header.message_type)
        # Its name is that of another data name only where a declaration says so.
        data = topic.data if header.chunk == header.data_name else header.chunk
        publisher = opened(f"{data}_chunk", messages.CLASSES[kind])
        outputs.chunk = ChunkWriter(publisher, kind, len(header.labels))
    return outputs


def _raw_writer(publisher: TopicPublisher, context: StreamContext) -> Writer:
    header = context.header
    if header.message_type.is_text:
        return TextWriter(publisher, header.message_type)
    return NumberWriter(publisher, header.message_type, len(header.labels), context.refusals)
