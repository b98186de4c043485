"""Opens the topics of a stream, with a message class and a writer for each."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from importlib import import_module
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import BatteryState, Imu, MagneticField, Temperature
from std_msgs.msg import (
    Empty,
    Float32,
    Float32MultiArray,
    Float64MultiArray,
    Int32MultiArray,
    Int64MultiArray,
    String,
    UInt8,
    UInt16,
)

from biosensor_common.quantities import MessageType, chunk_type
from biosensor_common.refusal import Refusal
from biosensor_common.ros.standard_messages import standard_messages
from lsl_to_ros.topics.bridge import Outputs
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

CLASSES: dict[MessageType, type[Any]] = {
    MessageType.DIAGNOSTIC_ARRAY: DiagnosticArray,
    MessageType.EMPTY: Empty,
    MessageType.FLOAT32: Float32,
    MessageType.FLOAT32_MULTI_ARRAY: Float32MultiArray,
    MessageType.FLOAT64_MULTI_ARRAY: Float64MultiArray,
    MessageType.INT32_MULTI_ARRAY: Int32MultiArray,
    MessageType.INT64_MULTI_ARRAY: Int64MultiArray,
    MessageType.STRING: String,
    MessageType.UINT8: UInt8,
    MessageType.UINT16: UInt16,
}
STANDARD_CLASSES: dict[str, type[Any]] = {
    f"sensor_msgs/msg/{each.__name__}": each
    for each in (BatteryState, Imu, MagneticField, Temperature)
}
"""Classes of additional messages, see `biosensor_common.ros.standard_messages`."""


def _own() -> dict[bool, type[Any]]:
    try:
        own = import_module("biosensor_msgs.msg")
    except ImportError:
        # nothing is dropped: the reports say that there are no stamped topics
        return {}
    return {True: own.Event, False: own.Samples}


_OWN = _own()
HAS_STAMPED_TOPICS = bool(_OWN)
"""Whether the package ``biosensor_msgs``, which has to be built, can be imported."""


def stamped_class(message_type: MessageType) -> type[Any]:
    """Return the message class of a stamped topic: ``Event`` for text, else ``Samples``.

    Raises
    ------
    KeyError
        If there are no stamped topics.
    """
    return _OWN[message_type.is_text]


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
        The original framework's topics of this stream, if they are wanted.

    Raises
    ------
    TopicTypeError
        If one of the topics is among the *used* ones and has another type.
    """
    header, topic = context.header, context.topic

    def opened(name: str, kind: type) -> TopicPublisher:
        # Latched, so that a late subscriber of a state gets the last value at once.
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
    outputs.timed += _standard_writers(context, opened)
    if header.chunk:
        kind = chunk_type(header.message_type)
        # The chunk's name differs from the data name only where a declaration says so.
        data = topic.data if header.chunk == header.data_name else header.chunk
        publisher = opened(f"{data}_chunk", CLASSES[kind])
        columns = first.columns if first else len(header.labels)
        outputs.chunk = ChunkWriter(publisher, kind, columns)
    return outputs


def _standard_writers(
    context: StreamContext, opened: Callable[[str, type], TopicPublisher]
) -> Iterator[Writer]:
    for standard in standard_messages(context.header, context.frame_id):
        try:
            publisher = opened(standard.data, STANDARD_CLASSES[standard.type_name])
        except TopicTypeError:
            # Another stream of the device already has that name.
            name = f"{context.topic.base}/{standard.data}"
            context.refusals.refuse(Refusal.NO_STANDARD_TOPIC, topic=name)
            continue
        context.refusals.over(Refusal.NO_STANDARD_TOPIC)
        yield StandardMessageWriter(publisher, standard, context.stamping)


def _raw_writer(publisher: TopicPublisher, context: StreamContext) -> Writer:
    header = context.header
    if header.message_type.is_text:
        return TextWriter(publisher, header.message_type)
    return NumberWriter(publisher, header.message_type, len(header.labels), context.refusals)
