"""Exports a recording to a bag: each stream on the topics that it has in the node."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection

from biosensor_common.naming import TopicName, resolve_topics
from biosensor_common.quantities import MessageType, queue_depth
from biosensor_common.ros.cdr import ENCAPSULATION, text
from biosensor_common.ros.messages import (
    RawNumbers,
    StampedNumbers,
    StampedTexts,
    counters_message,
    raw_text,
    text_of,
)
from biosensor_common.ros.standard_messages import (
    StandardMessage,
    standard_messages,
)
from biosensor_common.ros_clock import MAX_TIME_S, NS_PER_S
from biosensor_gateway.recording.bag.headers import (
    TOPIC,
    RecordedClock,
    RecordedStream,
    clock_text,
    stream_text,
)
from biosensor_gateway.recording.bag.types import EVENT, SAMPLES
from biosensor_gateway.recording.contents.choice import Chosen
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.contents.wall_clock import WallClock
from biosensor_gateway.recording.export.exporter import (
    Clock,
    ExportOptions,
    Missing,
    Progress,
    Times,
)
from biosensor_gateway.recording.export.mcap.bag_writer import Bag, new_bag
from biosensor_gateway.recording.export.readme import write_readme
from biosensor_gateway.recording.xdf.container import RecordingError, RecordingReason

PREFIX = "biosensors"
# A message has the time of its last sample, so it must not contain too many.
_MOST_BYTES = 1 << 20

Texts = list[tuple[str, ...]]


def names_of(streams: tuple[Stream, ...]) -> dict[int, TopicName]:
    """Return the topic names of all streams of a recording, by stream number.

    They are the same as in the node. There, two streams with the same identity would share a
    topic; here later ones get their number as a suffix, so they are not mixed.
    """
    wanted = {each.number: (each.meaning.identity, each.meaning.data_name) for each in streams}
    names = resolve_topics(wanted, PREFIX)
    used: set[str] = set()
    for number, name in names.items():
        unique = name
        while unique.name in used:
            unique = replace(unique, data=f"{unique.data}_{number}")
        used.add(unique.name)
        names[number] = unique
    return names


@dataclass(slots=True)
class Unfit:
    """Samples that do not fit a topic."""

    count: int = 0
    what: str = ""  # Why the first one does not fit, as the end of a sentence.

    def add(self, count: int, what: str) -> None:
        """Count further samples, and keep the reason of the first."""
        if count and not self.count:
            self.what = what
        self.count += count


class StreamTopics:
    """Writes one stream."""

    def __init__(self, bag: Bag, stream: Stream, name: TopicName) -> None:
        self._bag = bag
        self._header = header = stream.meaning
        self.topics: list[str] = []  # Topic names, the stamped topic first.
        self.unfit = Unfit()  # Samples missing on the raw topic; the stamped topic has them.
        self.written = 0
        self._base = f"/{name.base}"
        frame_id = name.frame_id(PREFIX)
        self._most = max(1, _MOST_BYTES // (8 * (1 + len(header.labels))))
        is_text = header.message_type.is_text
        self._stamped = self._open(f"{name.data}_stamped", EVENT if is_text else SAMPLES)
        self._raw = self._open(name.data, header.message_type.value)
        self._stamped_texts = StampedTexts(frame_id)
        self._stamped_numbers = StampedNumbers(header, frame_id)
        self._raw_numbers = None if is_text else RawNumbers(header.message_type, len(header.labels))
        self._standard: list[tuple[StandardMessage, Connection]] = []
        for each in standard_messages(header, frame_id):
            # Another stream of the device may already use that name.
            if f"{self._base}/{each.data}" not in bag.topics:
                self._standard.append((each, self._open(each.data, each.type_name)))

    def _open(self, data: str, type_name: str) -> Connection:
        topic = f"{self._base}/{data}"
        self.topics.append(topic)
        is_state = self._header.is_state
        depth = 1 if is_state else queue_depth(self._header.rate)
        return self._bag.open(topic, type_name, depth, latched=is_state)

    def write(self, unix_ns: NDArray[np.int64], values: NDArray[Any] | Texts) -> None:
        """Write samples.

        Parameters
        ----------
        unix_ns : ndarray of int64, shape (n,)
            Unix times that ROS can represent.
        values : ndarray, shape (n, n_channels), or list of tuple
        """
        if isinstance(values, list):
            self._write_texts(unix_ns, values)
        else:
            self._write_numbers(unix_ns, values)
        self.written += len(unix_ns)

    def _write_numbers(self, unix_ns: NDArray[np.int64], values: NDArray[Any]) -> None:
        assert self._raw_numbers is not None
        fits = self._raw_numbers.fitting(values)
        if fits is None:
            self._bag.add(self._raw, unix_ns, self._raw_numbers.encode(values))
        else:
            unfit = values[~fits][0, 0]
            self.unfit.add(int((~fits).sum()), f"{unfit} does not fit {self._header.message_type}")
            messages = self._raw_numbers.encode(values[fits])
            self._bag.add(self._raw, unix_ns[fits], messages)
        for start in range(0, len(unix_ns), self._most):
            part = slice(start, start + self._most)
            message = self._stamped_numbers.encode(
                unix_ns[part], values[part], self.written + start
            )
            # As in the node, a message has the time of its last sample.
            self._bag.add(self._stamped, unix_ns[part][-1:], [message])
        for standard, connection in self._standard:
            self._bag.add(connection, unix_ns, standard.encode(unix_ns, values))

    def _write_texts(self, unix_ns: NDArray[np.int64], values: Texts) -> None:
        times = unix_ns.tolist()
        told = [text_of(sample) for sample in values]
        stamped = [
            self._stamped_texts.encode(time, text, self.written + at)
            for at, (time, text) in enumerate(zip(times, told, strict=True))
        ]
        self._bag.add(self._stamped, times, stamped)
        if self._header.message_type is MessageType.DIAGNOSTIC_ARRAY:
            for time, (text, *_) in zip(times, values, strict=True):
                self._write_counters(time, text)
        else:
            raw = [raw_text(self._header.message_type, text) for text in told]
            self._bag.add(self._raw, times, raw)

    def _write_counters(self, time: int, text: str) -> None:
        try:
            message = counters_message(time, text)
        except ValueError as error:
            self.unfit.add(1, str(error))
        else:
            self._bag.add(self._raw, [time], [message])


_TOLD_EVERY_S = 1.0


_MEANS = """\
A ROS 2 bag: an MCAP file and its metadata. Foxglove opens the file, and so does ros2 bag play;
for topics that end in _stamped it needs the package biosensor_msgs of the gateway.

Topics are those that the gateway's node publishes for the same streams. Files not named above
are for the way back: biosensor-gateway bag import makes a recording from them again.
"""


class McapExporter:
    """Writes a folder with an MCAP file and metadata, like ``ros2 bag record``."""

    suffix = "_bag"

    def write(
        self, chosen: Chosen, options: ExportOptions, target: Path, progress: Progress
    ) -> Sequence[str]:
        """See :meth:`.exporter.Exporter.write`; times are always Unix times."""
        with new_bag(target) as bag:
            conversion = _Conversion(bag, chosen)
            conversion.run(progress)
        notes = list(conversion.sentences())
        if options.times is Times.EVEN:
            notes.append("a bag always has the recorded times, which its import needs")
        recorded = replace(options, clock=Clock.WALL, times=Times.RECORDED)
        write_readme(target, chosen, recorded, _MEANS, conversion.topics(), notes)
        return notes


class _Conversion:
    """The conversion of one recording to a bag."""

    def __init__(self, bag: Bag, chosen: Chosen) -> None:
        self._bag = bag
        self._chosen = chosen
        contents = chosen.contents
        self._wall = contents.wall or _no_wall_clock(chosen)
        self._begin_s = max(chosen.begin_s, contents.begin_s)
        self._timeless: dict[int, int] = {}
        self._latest_ns: dict[int, int] = {}
        self._moved: Counter[int] = Counter()
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
            message = f"no sample of {path} has a time of day, so no bag was written"
            raise RecordingError(RecordingReason.EMPTY, message)

    def _write(self, stream: Stream, samples: Samples) -> int | None:
        """Write the samples whose Unix time is valid; return the first time in ns."""
        # Times beyond this overflow in ns.
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
        self._note_order(stream, unix_ns)
        self._topics[stream.number].write(unix_ns, kept.values)
        return int(unix_ns[0])

    def _note_order(self, stream: Stream, unix_ns: NDArray[np.int64]) -> None:
        """Count samples whose message comes earlier in the bag than in the recording."""
        ends = unix_ns if stream.meaning.message_type.is_text else unix_ns[-1:]
        latest = np.maximum.accumulate(
            np.concatenate([[self._latest_ns.get(stream.number, 0)], ends])
        )
        is_earlier = ends < latest[:-1]
        if is_earlier.any():
            every = len(unix_ns) // len(ends)
            self._moved[stream.number] += every * int(np.count_nonzero(is_earlier))
        self._latest_ns[stream.number] = int(latest[-1])

    def _tell_origin(self, begin_ns: int) -> None:
        """Write the data for an import of the bag, at the time of the first sample."""
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
        """Return the topics of each stream by stream number."""
        return {number: each.topics for number, each in self._topics.items() if each.written}

    def sentences(self) -> Iterator[str]:
        """Yield sentences about what the bag lacks or contains only roughly."""
        wall = self._chosen.contents.wall
        if wall is None:
            moved_s = int(self._wall.offsets_ns[0]) // NS_PER_S
            moved = f", moved by {moved_s} s, because ROS has no time before 0," if moved_s else ""
            yield (
                "the time of day of the recording is unknown, so the bag's times are those of "
                f"the LSL clock{moved} and start in 1970"
            )
        elif wall.doubt:
            yield f"the time of day of the bag's messages {wall.doubt}"
        for stream in self._chosen.streams:
            topics, name = self._topics[stream.number], stream.header.title
            if missing := self._timeless.get(stream.number):
                samples = "1 sample" if missing == 1 else f"{missing} samples"
                are = "is" if missing == 1 else "are"
                yield Missing(f"{samples} of {name} {are} not in it: their timestamp is not valid")
            if moved := self._moved[stream.number]:
                yield (
                    f"{name}: its time steps back, and a bag is in order of time, so {moved} of "
                    "its samples come earlier in the bag than in the recording"
                )
            if topics.unfit.count:
                yield (
                    f"{topics.unfit.count} samples of {name} are on {topics.topics[0]} only: "
                    f"{topics.unfit.what}"
                )


def _no_wall_clock(chosen: Chosen) -> WallClock:
    """Return the LSL clock, moved by whole seconds if it shows times before 0."""
    begins = [found[0] for each in chosen.streams if (found := each.ends())]
    moved_s = max((math.ceil(-each) for each in begins if -MAX_TIME_S < each < 0), default=0)
    return WallClock("none", 0.0, np.zeros(1), np.array([moved_s * NS_PER_S]))
