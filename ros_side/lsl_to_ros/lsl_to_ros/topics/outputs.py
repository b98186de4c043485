"""Opens the topics of a stream, with a writer for each."""

from __future__ import annotations

from collections.abc import Collection

from biosensor_common.quantities import MessageType
from biosensor_common.refusal import Refusal
from biosensor_common.ros.standard_messages import standard_messages
from biosensor_common.topic_shape import chunk_type
from lsl_to_ros.topics.bridge import Outputs
from lsl_to_ros.topics.messages import CLASSES, HAS_STAMPED_TOPICS, STANDARD_CLASSES, stamped_class
from lsl_to_ros.topics.publishers import TopicPublisher, TopicPublishers, TopicTypeError
from lsl_to_ros.topics.writers import (
    ChunkWriter,
    CountersWriter,
    EventWriter,
    NumberWriter,
    SamplesWriter,
    StandardMessageWriter,
    StreamContext,
    TextWriter,
    Writer,
)


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

    raw = opened(topic.data, CLASSES[header.message_type])
    if header.message_type is MessageType.DIAGNOSTIC_ARRAY:
        return Outputs(timed=[CountersWriter(raw, context.stamping)])
    outputs = Outputs(raw=_raw_writer(raw, context))
    if HAS_STAMPED_TOPICS:
        publisher = opened(f"{topic.data}_stamped", stamped_class(header.message_type))
        stamped = EventWriter if header.message_type.is_text else SamplesWriter
        outputs.timed.append(stamped(publisher, context))
    for standard in standard_messages(header, context.frame_id):
        try:
            publisher = opened(standard.data, STANDARD_CLASSES[standard.type_name])
        except TopicTypeError:
            # Another stream of the device has that name as its own.
            name = f"{topic.base}/{standard.data}"
            context.refusals.refuse(Refusal.NO_STANDARD_TOPIC, topic=name)
            continue
        context.refusals.over(Refusal.NO_STANDARD_TOPIC)
        outputs.timed.append(StandardMessageWriter(publisher, standard, context.stamping))
    if header.chunk:
        kind = chunk_type(header.message_type)
        # Its name is that of another data name only where a declaration says so.
        data = topic.data if header.chunk == header.data_name else header.chunk
        publisher = opened(f"{data}_chunk", CLASSES[kind])
        outputs.chunk = ChunkWriter(publisher, kind, len(header.labels))
    return outputs


def _raw_writer(publisher: TopicPublisher, context: StreamContext) -> Writer:
    header = context.header
    if header.message_type.is_text:
        return TextWriter(publisher, header.message_type)
    return NumberWriter(publisher, header.message_type, len(header.labels), context.refusals)
