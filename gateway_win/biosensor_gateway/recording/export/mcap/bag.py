"""A new bag: opens topics, and writes messages in the order of time."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path

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
from rosbags.rosbag2 import StoragePlugin

from biosensor_gateway.recording.bag.types import typestore
from biosensor_gateway.recording.export.mcap.writer import BagWriter, Messages

# Messages that wait until no earlier one can come; of more, the oldest are written all the same.
_MOST_WAITING = 100_000
_MOST_WAITING_BYTES = 32_000_000
# As ROS writes it: for ever.
_INFINITE = QosTime(9_223_372_036, 854_775_807)


class Bag:
    """A bag that is being written."""

    def __init__(self, writer: BagWriter) -> None:
        self._writer = writer
        self._types: dict[str, str] = {}
        self._wait(Messages(np.empty(0, np.int64), np.empty(0, np.int64), []))

    @property
    def topics(self) -> frozenset[str]:
        """All that were opened."""
        return frozenset(self._types)

    def open(self, topic: str, type_name: str, depth: int, *, latched: bool = False) -> Connection:
        """Open a topic: a reliable one, as those of the node are.

        Parameters
        ----------
        depth
            Messages that its publisher keeps.
        latched
            Whether a later subscriber gets the last ones, too.
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
        """Take messages in, with the times at which the bag is to have them."""
        self._times.append(np.asarray(unix_ns, np.int64))
        self._channels.append(np.full(len(messages), connection.id))
        self._contents.extend(messages)
        self._waiting_bytes += sum(map(len, messages))

    def write_until(self, unix_ns: int) -> None:
        """Write what is before a time, once it is worth the while, or too much waits."""
        if len(self._contents) < _MOST_WAITING and self._waiting_bytes < _MOST_WAITING_BYTES:
            return
        waiting = self._waiting()
        count = int(np.searchsorted(waiting.unix_ns, unix_ns)) or len(waiting.contents) // 2
        self._writer.write_all(waiting.part(0, count))
        self._wait(waiting.part(count, len(waiting.contents)))

    def write_all(self) -> None:
        """Write all that waits."""
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
    """Make a bag, which is complete when the block ends without an error.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with BagWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        bag = Bag(writer)
        yield bag
        bag.write_all()
