"""Converts the messages of one topic to samples of streams."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Sequence
from operator import attrgetter
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from biosensor_common.errors import SpecError
from biosensor_common.quantities import ChannelFormat
from biosensor_common.ros.fields import (
    NAMES,
    Field,
    FieldKind,
    all_fields,
    bulk_of,
    fields_of,
    has_header,
)
from biosensor_common.ros.layout import Layout, LayoutChangedError
from biosensor_common.ros_clock import NS_PER_S
from biosensor_gateway.recording.bag.headers import (
    LATCHED,
    Facts,
    Origin,
    RecordedStream,
    facts_of_ours,
    facts_of_topic,
    header_xml,
)
from biosensor_gateway.recording.bag.types import (
    Message,
    MessageError,
    MessageType,
    Topic,
    UnsuitableError,
)
from biosensor_gateway.recording.xdf import chunks
from biosensor_gateway.recording.xdf.container import ChunkError
from biosensor_gateway.recording.xdf.header import parse_stream_header
from biosensor_gateway.recording.xdf.samples import Texts
from biosensor_gateway.recording.xdf.sender_clock import Offset, SenderClock, is_plausible

OFFSETS_EVERY_S = 5.0
"""LabRecorder measures clocks at this interval."""
# A longer gap means that the clock jumped, so it is not filled with offsets.
_LONGEST_SILENCE_S = 3600.0
# Chunks must be large enough for fast reading and small enough for memory.
_CHUNK_S, _MOST_PENDING = 1.0, 512
_DTYPES = {
    ChannelFormat.FLOAT32: np.float32,
    ChannelFormat.DOUBLE64: np.float64,
    ChannelFormat.INT64: np.int64,
    ChannelFormat.INT32: np.int32,
    ChannelFormat.INT16: np.int16,
    ChannelFormat.INT8: np.int8,
}


class StreamWriter:
    """Writes one stream.

    Parameters
    ----------
    form, channels
        As in the header.
    clock_offsets
        Measured pairs of LSL time on the stream's clock and offset to the file's clock, in s. None
        for a stream on the file's clock: then an offset of 0 is written every five seconds,
        because loaders complain without offsets.

    Attributes
    ----------
    first, last
        Timestamps of the first and last sample, 0 without samples.
    """

    def __init__(
        self,
        write: Callable[[bytes], object],
        number: int,
        xml: str,
        form: ChannelFormat,
        channels: int,
        clock_offsets: Sequence[tuple[float, float]] | None = None,
    ) -> None:
        self._write = write
        self.number = number
        self._form, self._channels = form, channels
        self._due = None if clock_offsets is None else _in_order(clock_offsets)
        self._clock = SenderClock(clock_offsets or ())
        self._times: list[NDArray[np.float64]] = []
        self._values: list[Any] = []
        self.first = self.last = 0.0
        self.sample_count = 0
        self.clock_offsets: list[tuple[float, float]] = []  # Those written to the file.
        write(chunks.stream_header(number, xml))

    def add(self, times: NDArray[np.float64], values: NDArray[Any] | Texts) -> None:
        """Add samples.

        Parameters
        ----------
        times : ndarray of float64, shape (n,)
            Finite, on the file's clock.
        values : ndarray, shape (n, n_channels), or list of tuple
        """
        if not len(times):
            return
        self._times.append(times)
        if isinstance(values, list):
            self._values.extend(values)
        else:
            self._values.append(values)
        if len(self._times) >= _MOST_PENDING or times[-1] - self._times[0][0] >= _CHUNK_S:
            self.flush()

    def flush(self) -> None:
        """Write the pending samples, after the clock offsets up to their time."""
        if not self._times:
            return
        times = np.concatenate(self._times)
        if self._form is ChannelFormat.STRING:
            values: Any = self._values
        else:
            with np.errstate(invalid="ignore", over="ignore"):
                values = np.concatenate(self._values).astype(_DTYPES[self._form], copy=False)
        for part in self._clock.parts(times):
            self._write_part(times[part], values[part])
        self._times, self._values = [], []

    def _write_part(self, times: NDArray[np.float64], values: NDArray[Any] | Texts) -> None:
        self._tell_clock(float(times.min()), float(times.max()))
        stamps = self._clock.to_sender(times)
        if not self.sample_count:
            self.first = float(stamps[0])
        self.last = float(stamps[-1])
        self.sample_count += len(stamps)
        self._write(chunks.samples(self.number, self._form, stamps, values))

    def end(self) -> None:
        """Write the remaining samples and the footer."""
        self.flush()
        if self._due is not None:
            self._tell_clock(0.0, math.inf)
        self._write(chunks.footer(self.number, self))

    def _tell_clock(self, first: float, until: float) -> None:
        if self._due is not None:
            while self._due and self._due[-1][0] <= until:
                self._tell(*self._due.pop()[1])
            return
        if not self.clock_offsets:
            self._tell(first, 0.0)
        told = self.clock_offsets[-1][0]
        if until - told > _LONGEST_SILENCE_S:
            self._tell(until, 0.0)
        while (told := self.clock_offsets[-1][0] + OFFSETS_EVERY_S) <= until:
            self._tell(told, 0.0)

    def _tell(self, taken_at: float, offset: float) -> None:
        self.clock_offsets.append((taken_at, offset))
        self._write(chunks.clock_offset(self.number, taken_at, offset))


def _in_order(offsets: Sequence[Offset]) -> list[tuple[float, Offset]]:
    """Return pairs of recorder's time and clock offset, the earliest last."""
    # None waits behind one that is not used, whose time may never come.
    is_used = is_plausible(np.array(offsets, np.float64).reshape(-1, 2)).tolist()
    times = [sum(each) if used else -math.inf for each, used in zip(offsets, is_used, strict=True)]
    return list(zip(reversed(times), reversed(offsets), strict=True))


ToLsl = Callable[[NDArray[np.int64]], NDArray[np.float64]]
"""Converts Unix times in ns to the clock of the file."""


class NewStream(Protocol):
    """Starts a new stream in the file."""

    def __call__(
        self,
        xml: str,
        form: ChannelFormat,
        channels: int,
        clock_offsets: tuple[tuple[float, float], ...] | None = None,
    ) -> StreamWriter:
        """Return the writer for its samples."""
        ...


class StampedTopic:
    """A topic of ``Samples`` or ``Event``: samples of a stream with their timestamps.

    Parameters
    ----------
    recorded
        The recorded stream that it was exported from; None if it was published live.
    facts
        Its entry in the node's list of streams; None if that was not recorded.
    raw_type
        Message type of its raw topic; empty if that was not recorded.
    """

    def __init__(
        self,
        topic: Topic,
        new_stream: NewStream,
        to_lsl: ToLsl,
        recorded: RecordedStream | None,
        facts: Facts | None,
        raw_type: str,
    ) -> None:
        self._topic, self._kind = topic, MessageType(topic)
        self._new_stream, self._to_lsl = new_stream, to_lsl
        self._facts, self._raw_type = facts, raw_type
        self._writer: StreamWriter | None = None
        self._columns, self._is_text = 0, False
        if recorded is not None:
            self._begin_recorded(recorded)

    def _begin_recorded(self, recorded: RecordedStream) -> None:
        try:
            header = parse_stream_header(recorded.xml.encode("utf-8", "surrogatepass"))
        except ChunkError as error:
            raise MessageError(f"the header of its stream: {error}") from error
        # Without clock offsets, timestamps are on the file's clock.
        offsets = recorded.clock_offsets or None
        self._begin(recorded.xml, header.format, header.channel_count, offsets)

    def _begin(
        self,
        xml: str,
        form: ChannelFormat,
        channels: int,
        offsets: tuple[tuple[float, float], ...] | None = None,
    ) -> StreamWriter:
        self._columns, self._is_text = channels, form is ChannelFormat.STRING
        self._writer = self._new_stream(xml, form, channels, offsets)
        return self._writer

    def take(self, message: Message) -> None:
        """Write the samples of a message.

        Raises
        ------
        MessageError
            If it cannot be read, or its shape differs from the previous ones.
        """
        read = self._kind.read(message.content)
        writer = self._writer or self._begin_live(read)
        begin_ns = read.header.stamp.sec * NS_PER_S + read.header.stamp.nanosec
        if isinstance(read.data, str) is not self._is_text:
            raise MessageError("it has text for numbers, or numbers for text")
        if self._is_text:
            writer.add(self._to_lsl(np.array([begin_ns])), self._texts(read.data))
            return
        values = read.integers if len(read.integers) else read.data
        if len(values) != len(read.offsets_ns) * self._columns:
            raise MessageError("its number of values differs from its stream's")
        times = self._to_lsl(begin_ns + read.offsets_ns)
        writer.add(times, values.reshape(-1, self._columns))

    def _begin_live(self, message: Any) -> StreamWriter:
        is_latched = LATCHED.search(self._topic.qos) is not None
        facts = self._facts or facts_of_ours(
            self._topic.name,
            message.header.frame_id,
            self._raw_type,
            message,
            is_latched=is_latched,
        )
        origin = Origin(self._topic.name, self._topic.type_name, "header")
        return self._begin(header_xml(facts, origin), facts.format, len(facts.labels))

    def _texts(self, text: str) -> Texts:
        if self._columns == 1:
            return [(text,)]
        try:
            told = json.loads(text)
        except (ValueError, RecursionError):
            told = None
        if not isinstance(told, list) or len(told) != self._columns:  # pyright: ignore[reportUnknownArgumentType]
            raise MessageError(f"its text is not a list of {self._columns} texts")
        return [tuple(map(str, told))]  # pyright: ignore[reportUnknownArgumentType]


# As `ros_to_lsl` calls it.
_TEXT = "__text"


def _texts_in(fields: Iterable[Field]) -> tuple[Field, ...]:
    """Return the fields of text, and the lists of messages with some; not the names of numbers."""
    return tuple(each for each in fields if _is_told(each) or _texts_in(each.elements))


def _is_told(field: Field) -> bool:
    names_numbers = field.name in NAMES and field.is_array
    is_frame = field.name.endswith("frame_id")
    return field.kind is FieldKind.TEXT and not (names_numbers or is_frame)


def _told_in(message: Any, fields: Iterable[Field]) -> dict[str, object]:
    """Return the texts of a message by path."""
    told: dict[str, object] = {}
    for each in fields:
        value = attrgetter(each.path)(message)
        if each.elements:
            inner = _texts_in(each.elements)
            told[each.path] = [_told_in(one, inner) for one in value]
        else:
            told[each.path] = [str(one) for one in value] if each.is_array else str(value)
    return told


class AnyTopic:
    """A topic of any type with numbers, or with text only.

    Texts next to numbers become a second stream, whose name ends in ``__text``, as live.
    """

    def __init__(self, topic: Topic, new_stream: NewStream, to_lsl: ToLsl) -> None:
        self._topic, self._kind = topic, MessageType(topic)
        definition = self._kind.definition
        self._has_header, self._bulk = has_header(definition), bulk_of(definition)
        self._fields = fields_of(definition)
        leaves = [each for each in all_fields(self._fields) if each.kind is not FieldKind.MESSAGE]
        self._has_numbers = any(each.kind is not FieldKind.TEXT for each in leaves)
        # Text fields of a message that also has numbers; they become a stream of their own.
        self._texts = _texts_in(self._fields) if self._has_numbers and not self._bulk else ()
        self._text_writer: StreamWriter | None = None
        self._new_stream, self._to_lsl = new_stream, to_lsl
        self._writers: dict[tuple[tuple[str, str], ...], StreamWriter] = {}
        self._layout: Layout | None = None
        self._writer: StreamWriter | None = None

    def take(self, message: Message) -> None:
        """Write a message as one sample.

        Raises
        ------
        MessageError
            If it cannot be read, or does not fit a stream.
        """
        read = self._kind.read(message.content)
        stamp_ns = self._stamp_ns(read) or message.unix_ns
        if self._texts:
            self._take_texts(read, self._to_lsl(np.array([stamp_ns])))
        values = self._values(read)
        samples: Any = np.array([values]) if values else [(str(read.data),)]
        assert self._writer is not None
        self._writer.add(self._to_lsl(np.array([stamp_ns])), samples)

    def _take_texts(self, message: Any, times: NDArray[np.float64]) -> None:
        """Write the texts of a message as one sample: the only one as it is, or all as JSON."""
        if self._text_writer is None:
            topic = self._topic
            form, channels = ChannelFormat.STRING, (("text", ""),)
            facts = facts_of_topic(f"{topic.name}{_TEXT}", topic.type_name, channels, form, 0)
            source = "header" if self._stamp_ns(message) else "log"
            origin = Origin(topic.name, topic.type_name, source)
            self._text_writer = self._new_stream(header_xml(facts, origin), form, 1)
        told = _told_in(message, self._texts)
        only = next(iter(told.values())) if len(told) == 1 else told
        text = only if isinstance(only, str) else json.dumps(only, ensure_ascii=False)
        self._text_writer.add(times, [(text,)])

    def _values(self, message: Any) -> Sequence[float]:
        """Return the numbers of a message; a changed layout starts a new stream."""
        layout = self._layout or self._lay_out(message)
        try:
            return layout.read(message)
        except LayoutChangedError:
            # A different shape starts a new stream, as with an outlet.
            return self._lay_out(message).read(message)

    def _lay_out(self, message: Any) -> Layout:
        if self._bulk:
            raise UnsuitableError(f"its field {self._bulk} holds images or the like, not numbers")
        try:
            layout = Layout(self._fields, message)
        except SpecError as error:
            raise UnsuitableError(str(error)) from error
        is_text = not self._has_numbers
        if is_text and not isinstance(getattr(message, "data", None), str):
            raise UnsuitableError(f"{self._topic.type_name} has no numbers")
        if not is_text and not layout.channels:
            raise MessageError("its sequences are empty, so it has no numbers")
        self._layout = layout
        channels = tuple((each.label, each.unit) for each in layout.channels) or (("text", ""),)
        self._writer = self._writers.get(channels)
        if self._writer is None:
            form = ChannelFormat.STRING if is_text else ChannelFormat.DOUBLE64
            facts = facts_of_topic(
                self._topic.name, self._topic.type_name, channels, form, len(self._writers)
            )
            source = "header" if self._stamp_ns(message) else "log"
            origin = Origin(self._topic.name, self._topic.type_name, source)
            self._writer = self._new_stream(header_xml(facts, origin), form, len(channels))
            self._writers[channels] = self._writer
        return layout

    def _stamp_ns(self, message: Any) -> int:
        if not self._has_header:
            return 0
        stamp = message.header.stamp
        return stamp.sec * NS_PER_S + stamp.nanosec
