"""Opens the topics of a stream, with a writer for each."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from biosensor_common.quantities import MessageType
from biosensor_common.refusal import Refusal
from biosensor_common.ros.standard_messages import standard_messages
from biosensor_common.topic_shape import chunk_type
from lsl_to_ros.topics.bridge import Outputs
from lsl_to_ros.topics.messages import CLASSES, HAS_STAMPED_TOPICS, STANDARD_CLASSES, stamped_class
from lsl_to_ros.topics.originals import (
    FurtherWriter,
    Original,
    Shape,
    message_class,
    writer,
)
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
    publishers: TopicPublishers,
    context: StreamContext,
    used: Collection[TopicPublisher] = (),
    originals: Sequence[Original] = (),
    shape: Shape | None = None,
) -> Outputs:
    """Open every topic of a stream: raw, stamped, those of ``sensor_msgs`` and chunks.

    Parameters
    ----------
    originals, shape
        What the original framework made of this stream, if the topics are to be as there.

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

    first, *further = originals or (None,)
    usual = CLASSES[header.message_type]
    raw = opened(topic.data, message_class(first, usual) if first else usual)
    if header.message_type is MessageType.DIAGNOSTIC_ARRAY:
        return Outputs(timed=[CountersWriter(raw, context.stamping)])
    outputs = Outputs(shape=shape)
    outputs.raw = (
        writer(raw, first, header.message_type, context.refusals)
        if first
        else _raw_writer(raw, context)
    )
    for each in filter(None, further):
        publisher = opened(each.data, message_class(each, usual))
        outputs.timed.append(FurtherWriter(publisher, each))
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
        columns = first.columns if first else len(header.labels)
        outputs.chunk = ChunkWriter(publisher, kind, columns)
    return outputs


def _raw_writer(publisher: TopicPublisher, context: StreamContext) -> Writer:
    header = context.header
    if header.message_type.is_text:
        return TextWriter(publisher, header.message_type)
    return NumberWriter(publisher, header.message_type, len(header.labels), context.refusals)
