"""Writes a new bag: opens topics and sorts messages by time."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter

from biosensor_common.ros.cdr import cut
from biosensor_gateway.recording.bag.types import typestore

if TYPE_CHECKING:
    from rosbags.rosbag2.writer import StorageWriter


# Limit of messages that wait for earlier ones; beyond it the oldest are written anyway.
_MOST_WAITING = 100_000
_MOST_WAITING_BYTES = 32_000_000
# ROS's value for infinity.
_INFINITE = QosTime(9_223_372_036, 854_775_807)
# See https://mcap.dev/spec#records.
_MESSAGE, _CHUNK, _MESSAGE_INDEX = 0x05, 0x06, 0x07
_RECORD = np.dtype([("op", "u1"), ("length", "<u8")])
_HEAD = np.dtype(
    [
        *_RECORD.descr,
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("logged_ns", "<u8"),
        ("published_ns", "<u8"),
    ]
)
_PLACE = np.dtype([("logged_ns", "<u8"), ("offset", "<u8")])
# The same size as in the library.
_CHUNK_BYTES = 1 << 20


class Bag:
    """A bag that is being written."""

    def __init__(self, writer: BagWriter) -> None:
        self._writer = writer
        self._types: dict[str, str] = {}
        self._wait(Messages(np.empty(0, np.int64), np.empty(0, np.int64), []))

    @property
    def topics(self) -> frozenset[str]:
        """Names of all opened topics."""
        return frozenset(self._types)

    def open(self, topic: str, type_name: str, depth: int, *, latched: bool = False) -> Connection:
        """Open a topic with reliable QoS, like the node's topics.

        Parameters
        ----------
        depth
            History depth of its publisher.
        latched
            Whether late subscribers get the last messages, too.
        """
        durability = QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
        qos = Qos(
            history=QosHistory.KEEP_LAST,
            depth=depth,
            reliability=QosReliability.RELIABLE,
            durability=durability,
            deadline=_INFINITE,
            lifespan=_INFINITE,
            liveliness=QosLiveliness.AUTOMATIC,
            liveliness_lease_duration=_INFINITE,
            avoid_ros_namespace_conventions=False,
        )
        self._types[topic] = type_name
        return self._writer.add_connection(
            topic, type_name, typestore=typestore(), offered_qos_profiles=[qos]
        )

    def add(
        self,
        connection: Connection,
        unix_ns: NDArray[np.int64] | Sequence[int],
        messages: list[bytes],
    ) -> None:
        """Add messages with their times in the bag."""
        self._times.append(np.asarray(unix_ns, np.int64))
        self._channels.append(np.full(len(messages), connection.id))
        self._contents.extend(messages)
        self._waiting_bytes += sum(map(len, messages))

    def write_until(self, unix_ns: int) -> None:
        """Write the messages before a time, if enough of them are waiting."""
        if len(self._contents) < _MOST_WAITING and self._waiting_bytes < _MOST_WAITING_BYTES:
            return
        waiting = self._waiting()
        count = int(np.searchsorted(waiting.unix_ns, unix_ns)) or len(waiting.contents) // 2
        self._writer.write_all(waiting.part(0, count))
        self._wait(waiting.part(count, len(waiting.contents)))

    def write_all(self) -> None:
        """Write all waiting messages."""
        self._writer.write_all(self._waiting())

    def _waiting(self) -> Messages:
        times, channels = np.concatenate(self._times), np.concatenate(self._channels)
        return Messages(times, channels, self._contents).in_time()

    def _wait(self, messages: Messages) -> None:
        self._times, self._channels = [messages.unix_ns], [messages.channels]
        self._contents = messages.contents
        self._waiting_bytes = sum(map(len, messages.contents))


@contextmanager
def new_bag(folder: Path) -> Generator[Bag]:
    """Create a bag, which is complete when the context ends without an error.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with BagWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        bag = Bag(writer)
        yield bag
        bag.write_all()


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages of any topics.

    Attributes
    ----------
    unix_ns : ndarray of int64, shape (n,)
    channels : ndarray of int64, shape (n,)
        Channel numbers of their topics in the bag.
    contents
        n serialised messages.
    """

    unix_ns: NDArray[np.int64]
    channels: NDArray[np.int64]
    contents: list[bytes]

    def in_time(self) -> Messages:
        """Return them sorted by time; the sort is stable."""
        order = np.argsort(self.unix_ns, kind="stable")
        places: list[int] = order.tolist()
        contents = [self.contents[place] for place in places]
        return Messages(self.unix_ns[order], self.channels[order], contents)

    def part(self, begin: int, end: int) -> Messages:
        """Return the messages from `begin` to before `end`."""
        return Messages(self.unix_ns[begin:end], self.channels[begin:end], self.contents[begin:end])


class _McapFile(McapWriter):
    def write_all(self, messages: Messages) -> None:
        """Write messages in time order."""
        sizes = np.fromiter(map(len, messages.contents), np.int64) + _HEAD.itemsize
        ends = np.cumsum(sizes)
        begin, count = 0, len(sizes)
        while begin < count:
            full = int(ends[begin] - sizes[begin]) + _CHUNK_BYTES
            end = min(int(np.searchsorted(ends, full, side="right")) + 1, count)
            self._write_chunk(messages.part(begin, end), sizes[begin:end])
            begin = end

    def _write_chunk(self, messages: Messages, sizes: NDArray[np.int64]) -> None:
        declared = self.chunk.bio.getvalue()
        first_ns, last_ns = int(messages.unix_ns[0]), int(messages.unix_ns[-1])
        self.message_start_time = min(first_ns, self.message_start_time)
        self.message_end_time = max(last_ns, self.message_end_time)
        content = declared + _records(messages, sizes)
        size = len(content).to_bytes(8, "little")
        times = first_ns.to_bytes(8, "little") + last_ns.to_bytes(8, "little")
        start = self.bio.tell()
        # Without checksum and compression.
        self._write(_CHUNK, times + size + bytes(4) + bytes(4) + size + content)
        end = self.bio.tell()
        places = np.empty(len(sizes), _PLACE)
        places["logged_ns"] = messages.unix_ns
        places["offset"] = len(declared) + np.cumsum(sizes) - sizes
        index: list[bytes] = []
        for channel in np.unique(messages.channels).tolist():
            of_channel = places[messages.channels == channel].tobytes()
            self.channel_stats[channel] += len(of_channel) // _PLACE.itemsize
            number = channel.to_bytes(2, "little")
            index.append(number + self.bio.tell().to_bytes(8, "little"))
            length = len(of_channel).to_bytes(4, "little")
            self._write(_MESSAGE_INDEX, number + length + of_channel)
        numbers = (start, end - start)
        told = times + b"".join(each.to_bytes(8, "little") for each in numbers)
        told += len(b"".join(index)).to_bytes(4, "little") + b"".join(index)
        told += (self.bio.tell() - end).to_bytes(8, "little") + bytes(4) + size + size
        self.chunks.append(BytesIO())
        self.chunks[-1].write(told)
        self.chunk.bio = BytesIO()

    def _write(self, op: int, content: bytes) -> None:
        self.bio.write(np.array((op, len(content)), _RECORD).tobytes())
        self.bio.write(content)


def _records(messages: Messages, sizes: NDArray[np.int64]) -> bytes:
    heads = np.zeros(len(sizes), _HEAD)
    heads["op"], heads["length"] = _MESSAGE, sizes - _RECORD.itemsize
    heads["channel"] = messages.channels
    heads["logged_ns"] = heads["published_ns"] = messages.unix_ns
    parts = [b""] * (2 * len(sizes))
    parts[::2], parts[1::2] = cut(heads.tobytes(), _HEAD.itemsize), messages.contents
    return b"".join(parts)


class BagWriter(Writer):
    """Writes a bag with an MCAP file."""

    STORAGE_PLUGINS: Mapping[StoragePlugin, type[StorageWriter]] = {StoragePlugin.MCAP: _McapFile}

    def write_all(self, messages: Messages) -> None:
        """Write messages in time order.

        Raises
        ------
        OSError
            If they cannot be written.
        """
        if not messages.contents:
            return
        assert isinstance(self.storage, _McapFile)
        self.storage.write_all(messages)
        self.counts.update(self.storage.channel_stats)
        self.min_timestamp = self.storage.message_start_time
        self.max_timestamp = self.storage.message_end_time
