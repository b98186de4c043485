"""The topics of one stream: those that it has in the node, with what it takes to write them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection

from biosensor_common.naming import TopicName, resolve_topics
from biosensor_common.quantities import MessageType
from biosensor_common.ros.numbers import RawNumbers, StampedNumbers
from biosensor_common.ros.standard_messages import (
    StandardMessage,
    standard_messages,
)
from biosensor_common.ros.texts import (
    StampedTexts,
    counters_message,
    raw_text,
)
from biosensor_common.topic_shape import queue_depth
from biosensor_common.topic_text import text_of
from biosensor_gateway.recording.bag.types import EVENT, SAMPLES
from biosensor_gateway.recording.contents.stream import Stream
from biosensor_gateway.recording.export.mcap.bag import Bag

PREFIX = "biosensors"
# A message is there when its last sample is, so it is to hold not too many.
_MOST_BYTES = 1 << 20

Texts = list[tuple[str, ...]]


def names_of(streams: tuple[Stream, ...]) -> dict[int, TopicName]:
    """Give all streams of a recording their topics, by their numbers.

    They are those of the node. Two streams that claim to be one would share a topic there; here
    the later ones get their number at the end, so that none is mixed with another.
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
    """Samples that a topic of a stream could not hold.

    Attributes
    ----------
    what
        Of the first, as the rest of a sentence.
    """

    count: int = 0
    what: str = ""

    def add(self, count: int, what: str) -> None:
        """Take note of some."""
        if count and not self.count:
            self.what = what
        self.count += count


class StreamTopics:
    """Writes one stream.

    Attributes
    ----------
    topics
        Names, the stamped one first.
    unfit
        What the raw topic does not have; the stamped one has it.
    written
        Number of samples.
    """

    def __init__(self, bag: Bag, stream: Stream, name: TopicName) -> None:
        self._bag = bag
        self._header = header = stream.meaning
        self.topics: list[str] = []
        self.unfit = Unfit()
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
            # Another stream of the device may have that name as its own.
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
            Times of day that ROS has.
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
            # As with the node, it is there when its last sample is.
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
