"""Converts a bag to a recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

import numpy as np

from biosensor_common.errors import cannot_write
from biosensor_common.quantities import ChannelFormat
from biosensor_common.ros_clock import NS_PER_S, ClockPair
from biosensor_gateway.recording.bag.bag_file import bag_files, read_bag
from biosensor_gateway.recording.bag.headers import (
    STAMPED,
    TOPIC,
    Facts,
    RecordedClock,
    RecordedStream,
    listed_facts,
    read_text,
)
from biosensor_gateway.recording.bag.topic_streams import (
    AnyTopic,
    NewStream,
    StampedTopic,
    StreamWriter,
)
from biosensor_gateway.recording.bag.types import (
    EVENT,
    SAMPLES,
    BagError,
    BagReason,
    Message,
    MessageError,
    MessageType,
    Topic,
    UnsuitableError,
)
from biosensor_gateway.recording.contents.wall_clock import WallClock
from biosensor_gateway.recording.xdf import chunks
from biosensor_gateway.system.new_file import new_file

_MOST_STREAMS = 10_000
_BOUNDARY_BYTES = 1 << 20
# Topics of ROS itself, which describe nodes and not a study.
_OF_ROS = ("/rosout", "/parameter_events")
_LIST_TYPE, _LIST_END = "diagnostic_msgs/msg/DiagnosticArray", "/streams"


@dataclass(frozen=True, slots=True)
class Imported:
    """The result of importing a bag."""

    # path, written: the bag and the recording.
    path: Path
    written: Path
    streams: tuple[tuple[str, int], ...]  # Name of the topic and number of samples of each stream.
    left_out: Mapping[str, str]  # Why a topic is not in the recording, by its name.
    damages: tuple[str, ...]  # Sentences about what could not be read.
    # A sentence about information on streams that is missing in the bag; empty if nothing is.
    guess: str


def usual_path(bag: Path) -> Path:
    """Return the default path of the recording: next to the bag, with its name."""
    name = bag.name if bag.is_dir() else bag.stem
    return bag.with_name(f"{name}.xdf")


def import_bag(path: Path, target: Path) -> Imported:
    """Convert a bag to a recording.

    Raises
    ------
    BagError
        If nothing can be read, nothing fits a recording, or the file cannot be written.
    """
    surveyed = survey_bag(path)
    try:
        with new_file(target, like=bag_files(path)[0]) as file:
            conversion = _Conversion(file, surveyed)
            conversion.run(path)
            if not conversion.has_samples:
                raise BagError(
                    BagReason.EMPTY, f"{path} contains nothing that a recording can hold"
                )
    except FileExistsError:
        message = f"{target} exists and is not overwritten; name another with --output"
        raise BagError(BagReason.EXISTS, message) from None
    except OSError as error:
        message = cannot_write(target, error)
        raise BagError(BagReason.UNWRITABLE, message) from error
    return Imported(
        path,
        target,
        tuple(conversion.counts()),
        conversion.left_out,
        tuple(dict.fromkeys((*surveyed.damages, *conversion.damages()))),
        surveyed.guess(),
    )


class _Conversion:
    """The conversion of one bag to a file."""

    def __init__(self, file: BinaryIO, surveyed: Survey) -> None:
        self._file, self._survey = file, surveyed
        self._writers: list[tuple[str, StreamWriter]] = []
        self._sinks: dict[str, StampedTopic | AnyTopic] = {}
        self.left_out: dict[str, str] = {}
        self._unread: Counter[tuple[str, str]] = Counter()
        self._since_boundary = 0
        self._begin()

    def _begin(self) -> None:
        recorded = self._survey.clock
        if recorded is None:
            begin_ns = self._survey.begin_ns
            date = datetime.fromtimestamp(begin_ns / NS_PER_S, UTC)
            begun = date.isoformat(timespec="seconds")
            # The file's clock is Unix time then.
            wall = WallClock("bag", 0.0, np.zeros(1), np.zeros(1, np.int64))
        else:
            begun, wall = recorded.begun, recorded.wall
        self._wall = wall
        chunks.begin(self._file, begun, wall_pairs(wall), wall.resolution_s)

    @property
    def has_samples(self) -> bool:
        """Whether any sample was written."""
        return any(writer.sample_count for _, writer in self._writers)

    def counts(self) -> list[tuple[str, int]]:
        """Return the topic and number of samples of each stream."""
        return [(topic, writer.sample_count) for topic, writer in self._writers]

    def damages(self) -> list[str]:
        """Return sentences about messages that could not be read."""
        return [
            f"{topic}: {count} messages are left out ({why})"
            for (topic, why), count in self._unread.items()
        ]

    def run(self, path: Path) -> None:
        """Convert all topics."""
        for topic in self._survey.in_order():
            self._open(topic)
        for message in read_bag(path, lambda _: None):
            sink = self._sinks.get(message.topic.name)
            if sink is not None:
                self._take(sink, message)
        for _, writer in self._writers:
            writer.end()

    def _take(self, sink: StampedTopic | AnyTopic, message: Message) -> None:
        try:
            sink.take(message)
        except UnsuitableError as error:
            self.left_out[message.topic.name] = str(error)
            del self._sinks[message.topic.name]
        except MessageError as error:
            self._unread[message.topic.name, str(error)] += 1

    def _open(self, topic: Topic) -> None:
        name = topic.name
        if name in self._survey.elsewhere:
            return
        try:
            if topic.type_name in (SAMPLES, EVENT):
                self._sinks[name] = StampedTopic(
                    topic,
                    self._new_stream_of(name),
                    self._wall.to_lsl,
                    self._survey.recorded.get(name),
                    self._survey.facts.get(name),
                    self._survey.raw_type(name),
                )
            else:
                self._sinks[name] = AnyTopic(topic, self._new_stream_of(name), self._wall.to_lsl)
        except MessageError as error:
            self.left_out[name] = str(error)

    def _new_stream_of(self, topic: str) -> NewStream:
        def new_stream(
            xml: str,
            form: ChannelFormat,
            channels: int,
            clock_offsets: tuple[tuple[float, float], ...] | None = None,
        ) -> StreamWriter:
            if len(self._writers) == _MOST_STREAMS:
                raise UnsuitableError(f"a recording holds {_MOST_STREAMS} streams at most")
            number = len(self._writers) + 1
            writer = StreamWriter(self._write, number, xml, form, channels, clock_offsets)
            self._writers.append((topic, writer))
            return writer

        return new_stream

    def _write(self, chunk: bytes) -> None:
        self._file.write(chunk)
        self._since_boundary += len(chunk)
        if self._since_boundary > _BOUNDARY_BYTES:
            self._since_boundary = 0
            self._file.write(chunks.boundary())


def wall_pairs(wall: WallClock) -> list[ClockPair]:
    """Return the pairs of LSL time and Unix time of a wall clock."""
    pairs = zip(wall.times.tolist(), wall.offsets_ns.tolist(), strict=True)
    return [ClockPair(lsl_s, round(lsl_s * NS_PER_S) + offset_ns) for lsl_s, offset_ns in pairs]


@dataclass(slots=True)
class Survey:
    """What is known about a bag before its samples are read."""

    # Topics with messages, by name.
    topics: dict[str, Topic] = field(default_factory=dict[str, Topic])
    begin_ns: int = 0  # Unix time of the earliest message.
    # clock, recorded: clock of the recording that it was exported from, and its streams by stamped
    # topic.
    clock: RecordedClock | None = None
    recorded: dict[str, RecordedStream] = field(default_factory=dict[str, RecordedStream])
    # The node's list of streams, by stamped topic.
    facts: dict[str, Facts] = field(default_factory=dict[str, Facts])
    damages: list[str] = field(default_factory=list[str])

    @property
    def elsewhere(self) -> frozenset[str]:
        """Topics to skip: without samples, or with samples that are also on a stamped topic."""
        names = {TOPIC, *_OF_ROS, *(each for each in self.topics if _is_list(self.topics[each]))}
        for stream in self.recorded.values():
            names.update(stream.topics)
        stamped = {name for name, topic in self.topics.items() if _is_stamped(topic)}
        for name in stamped:
            raw = name.removesuffix(STAMPED)
            names.update((raw, f"{raw}_chunk"))
        return frozenset(names - stamped - self.recorded.keys())

    def guess(self) -> str:
        """Return a note about streams described only by their messages; empty if there are none."""
        stamped = {name for name, topic in self.topics.items() if _is_stamped(topic)}
        unlisted = sorted(stamped - self.recorded.keys() - self.facts.keys())
        if not unlisted:
            return ""
        more = f" and {len(unlisted) - 1} more" if len(unlisted) > 1 else ""
        return (
            f"{unlisted[0]}{more}: the node's list of streams is not in the bag, so names, "
            "types, formats and rates of these streams are guesses, and losses cannot be found; "
            "also record its topic: add |.*/streams to the regex of ros2 bag record"
        )

    def raw_type(self, stamped: str) -> str:
        """Return the type of a stamped topic's raw topic; empty if it was not recorded."""
        raw = self.topics.get(stamped.removesuffix(STAMPED))
        return "" if raw is None else raw.type_name

    def in_order(self) -> Iterator[Topic]:
        """Yield all topics: first those of the exported recording in its order, then the others."""
        for stream in self.recorded.values():
            yield self.topics.get(stream.stamped) or Topic(stream.stamped, SAMPLES)
        for name, topic in self.topics.items():
            if name not in self.recorded:
                yield topic


def survey_bag(path: Path) -> Survey:
    """Read the topics of a bag and the information about its streams.

    Raises
    ------
    BagError
        If it cannot be read, or has no messages.
    """
    survey = Survey()
    lists = _Kinds()
    for message in read_bag(path, survey.damages.append):
        topic = message.topic
        if topic.name not in survey.topics:
            survey.topics[topic.name] = topic
            survey.begin_ns = min(survey.begin_ns or message.unix_ns, message.unix_ns)
        if topic.name == TOPIC or _is_list(topic):
            _take(survey, lists, message)
    if not survey.topics:
        why = f": {survey.damages[0]}" if survey.damages else ""
        raise BagError(BagReason.EMPTY, f"{path} holds no message{why}")
    return survey


class _Kinds(dict[Topic, MessageType]):
    """Cache of message types by topic."""

    def __missing__(self, topic: Topic) -> MessageType:
        self[topic] = kind = MessageType(topic)
        return kind


def _take(survey: Survey, kinds: _Kinds, message: Message) -> None:
    """Update the survey with one message."""
    try:
        read = kinds[message.topic].read(message.content)
        if message.topic.name != TOPIC:
            survey.facts.update(listed_facts(read.status))
            return
        told = read_text(read.data)
    except (AttributeError, MessageError, ValueError) as error:
        survey.damages.append(f"{message.topic.name}: a message cannot be decoded ({error})")
        return
    if isinstance(told, RecordedClock):
        survey.clock = told
    else:
        survey.recorded[told.stamped] = told


def _is_stamped(topic: Topic) -> bool:
    return topic.type_name in (SAMPLES, EVENT)


def _is_list(topic: Topic) -> bool:
    return topic.type_name == _LIST_TYPE and topic.name.endswith(_LIST_END)
