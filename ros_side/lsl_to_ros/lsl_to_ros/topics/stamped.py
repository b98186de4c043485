"""``<data>_stamped``: samples and events with the time at which they were measured.

The messages are this project's own and have to be built, so they may be missing: then
this module cannot be imported.
"""

from __future__ import annotations

from array import array

import numpy as np
from biosensor_msgs.msg import Event, Samples
from std_msgs.msg import Header

from biosensor_common.quantities import ChannelFormat
from biosensor_common.stream_header import StreamHeader
from biosensor_common.topic_text import text_of
from lsl_to_ros.accounts.stamping import Stamping
from lsl_to_ros.lsl.blocks import Run
from lsl_to_ros.topics.publishers import TopicPublisher
from lsl_to_ros.topics.writers import StreamContext, Writer


class SamplesWriter(Writer):
    """One message for the samples that came together."""

    def __init__(self, publisher: TopicPublisher, context: StreamContext) -> None:
        super().__init__(publisher)
        header = context.header
        self._labels, self._units = list(header.labels), list(header.units)
        self._is_int64 = header.format is ChannelFormat.INT64
        self._frame_id = context.frame_id
        self._stamping = context.stamping
        self._lost = context.lost

    def write(self, run: Run) -> None:
        """Publish a run as one message."""
        stamp = self._stamping.to_time(float(run.stamps[0]))
        lost = self._lost()
        offsets = np.rint((run.stamps - run.stamps[0]) * 1e9).astype(np.int64)
        message = Samples(
            header=Header(stamp=stamp, frame_id=self._frame_id),
            sequence=run.sequence,
            lost=lost.count,
            lost_is_estimated=lost.is_estimated,
            labels=self._labels,
            units=self._units,
            offsets_ns=array("q", offsets.tobytes()),
        )
        if self._is_int64:
            message.integers = array("q", run.samples.astype(np.int64).tobytes())
        else:
            message.data = array("d", run.samples.astype(np.float64).tobytes())
        self.publisher.publish(message)


class EventWriter(Writer):
    """One message a sample of text."""

    def __init__(self, publisher: TopicPublisher, frame_id: str, stamping: Stamping) -> None:
        super().__init__(publisher)
        self._frame_id = frame_id
        self._stamping = stamping

    def write(self, run: Run) -> None:
        """Publish each event."""
        for number, (sample, stamp) in enumerate(zip(run.samples, run.stamps, strict=True)):
            header = Header(stamp=self._stamping.to_time(float(stamp)), frame_id=self._frame_id)
            event = Event(
                header=header,
                sequence=run.sequence + number,
                data=text_of(sample),
            )
            self.publisher.publish(event)


def message_class(header: StreamHeader) -> type[Event | Samples]:
    """Return what a stream's stamped topic carries."""
    return Event if header.message_type.is_text else Samples


def writer(publisher: TopicPublisher, context: StreamContext) -> Writer:
    """Return what writes a stream's stamped topic."""
    if context.header.message_type.is_text:
        return EventWriter(publisher, context.frame_id, context.stamping)
    return SamplesWriter(publisher, context)
