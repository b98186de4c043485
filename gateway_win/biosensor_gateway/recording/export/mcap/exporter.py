"""Writes a recording as a bag."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from biosensor_common.ros.cdr import ENCAPSULATION, text
from biosensor_common.ros_clock import MAX_TIME_S, NS_PER_S
from biosensor_gateway.recording.bag.recorded_streams import (
    TOPIC,
    RecordedClock,
    RecordedStream,
    clock_text,
    stream_text,
)
from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.contents.wall_clock import WallClock
from biosensor_gateway.recording.export.exporter import Clock, Missing, Order, Progress, Times
from biosensor_gateway.recording.export.mcap.bag import Bag, new_bag
from biosensor_gateway.recording.export.mcap.stream_topics import StreamTopics, names_of
from biosensor_gateway.recording.export.readme import write_readme
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason

_TOLD_EVERY_S = 1.0


_MEANS = """\
A ROS 2 bag: an MCAP file and its metadata. Foxglove opens the file, and so does ros2 bag play;
for topics that end in _stamped it needs the package biosensor_msgs of the gateway.

Topics are those that the gateway's node publishes of the same streams. What is not named above
is for the way back: biosensor-gateway bag import makes the recording of it again.
"""


class McapExporter:
    """A folder with an MCAP file and its metadata, as ``ros2 bag record`` makes them."""

    suffix = "_bag"

    def write(
        self, chosen: Chosen, order: Order, target: Path, progress: Progress
    ) -> Sequence[str]:
        """See :meth:`.exporter.Exporter.write`; times are those of day, whatever is ordered."""
        with new_bag(target) as bag:
            conversion = _Conversion(bag, chosen)
            conversion.run(progress)
        notes = list(conversion.sentences())
        if order.times is Times.EVEN:
            notes.append("a bag has the recorded times, for the way back needs them")
        recorded = replace(order, clock=Clock.WALL, times=Times.RECORDED)
        write_readme(target, chosen, recorded, _MEANS, conversion.topics(), notes)
        return notes


class _Conversion:
    """One recording on its way into a bag."""

    def __init__(self, bag: Bag, chosen: Chosen) -> None:
        self._bag = bag
        self._chosen = chosen
        contents = chosen.contents
        self._wall = contents.wall or _no_wall_clock()
        self._begin_s = max(chosen.begin_s, contents.begin_s)
        self._timeless: dict[int, int] = {}
        self._is_told = False
        names = names_of(contents.streams)
        self._topics = {
            each.number: StreamTopics(bag, each, names[each.number]) for each in chosen.streams
        }

    def run(self, progress: Progress) -> None:
        told_s = self._begin_s
        for stream, samples in self._chosen.merged():
            first_ns = self._write(stream, samples)
            if first_ns is not None:
                self._bag.write_until(first_ns)
            if (now_s := float(samples.times[0])) > told_s + _TOLD_EVERY_S:
                told_s = now_s
                progress(now_s - self._begin_s)
        if not self._is_told:
            path = self._chosen.contents.path
            message = f"no sample of {path} has a time of day, so there is nothing for a bag"
            raise RecordingError(RecordingReason.EMPTY, message)

    def _write(self, stream: Stream, samples: Samples) -> int | None:
        """Write what has a time of day; return the first one, in ns."""
        # In ns, times beyond that cannot be told.
        kept = samples.picked(np.abs(samples.times) < MAX_TIME_S)
        unix_ns = self._wall.to_unix_ns(kept.times)
        is_time = (unix_ns >= 0) & (unix_ns < MAX_TIME_S * NS_PER_S)
        kept, unix_ns = kept.picked(is_time), unix_ns[is_time]
        missing = len(samples) - len(kept)
        if missing:
            self._timeless[stream.number] = self._timeless.get(stream.number, 0) + missing
        if not len(kept):
            return None
        if not self._is_told:
            self._tell_origin(int(unix_ns[0]))
        self._topics[stream.number].write(unix_ns, kept.values)
        return int(unix_ns[0])

    def _tell_origin(self, begin_ns: int) -> None:
        """Write what the way back needs, at the time of the first sample."""
        self._is_told = True
        contents = self._chosen.contents
        told = [clock_text(RecordedClock(contents.begun, self._wall))]
        for stream in self._chosen.streams:
            topics = self._topics[stream.number].topics
            recorded = RecordedStream(
                stream.number, topics[0], tuple(topics), stream.header.xml, stream.clock_offsets
            )
            told.append(stream_text(recorded))
        connection = self._bag.open(TOPIC, "std_msgs/msg/String", len(told), latched=True)
        messages = [ENCAPSULATION + text(each) for each in told]
        self._bag.add(connection, [begin_ns] * len(messages), messages)

    def topics(self) -> dict[int, Sequence[str]]:
        """Return the topics of each stream, by its number."""
        return {number: each.topics for number, each in self._topics.items() if each.written}

    def sentences(self) -> Iterator[str]:
        """Say what the bag does not have, or not well."""
        wall = self._chosen.contents.wall
        if wall is None:
            yield (
                "nothing in the recording tells the time of day, so the bag's times are those of "
                "the LSL clock and begin in 1970"
            )
        elif wall.doubt:
            yield f"the time of day of the bag's messages {wall.doubt}"
        for stream in self._chosen.streams:
            topics, name = self._topics[stream.number], stream.header.name
            if missing := self._timeless.get(stream.number):
                said = f"{missing} samples of {name} are not in it: their stamp is no time of day"
                yield said if topics.written else Missing(said)
            if topics.unfit.count:
                yield (
                    f"{topics.unfit.count} samples of {name} are on {topics.topics[0]} only: "
                    f"{topics.unfit.what}"
                )


def _no_wall_clock() -> WallClock:
    return WallClock("none", 0.0, np.zeros(1), np.zeros(1, np.int64))
