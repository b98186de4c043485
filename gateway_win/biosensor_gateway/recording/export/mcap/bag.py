"""A new bag: opens topics, and writes messages in the order of time."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from pathlib import Path

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

from biosensor_gateway.recording.bag.types import typestore

# Messages that wait until no earlier one can come; of more, the oldest are written all the same.
_MOST_WAITING = 100_000
_MOST_WAITING_BYTES = 32_000_000
# As ROS writes it: for ever.
_INFINITE = QosTime(9_223_372_036, 854_775_807)


class Bag:
    """A bag that is being written."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._types: dict[str, str] = {}
        self._waiting: list[tuple[int, int, Connection, bytes]] = []
        self._waiting_bytes = 0
        self._count = 0

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

    def add(self, connection: Connection, unix_ns: Iterable[int], messages: list[bytes]) -> None:
        """Take messages in, with the times at which the bag is to have them."""
        first = self._count
        self._count += len(messages)
        numbers = range(first, self._count)
        each = zip(unix_ns, numbers, [connection] * len(messages), messages, strict=True)
        self._waiting.extend(each)
        self._waiting_bytes += sum(map(len, messages))

    def write_until(self, unix_ns: int) -> None:
        """Write what is before a time, once it is worth the while, or too much waits."""
        if len(self._waiting) < _MOST_WAITING and self._waiting_bytes < _MOST_WAITING_BYTES:
            return
        self._waiting.sort()
        self._write(self._place_of(unix_ns) or len(self._waiting) // 2)

    def write_all(self) -> None:
        """Write all that waits."""
        self._waiting.sort()
        self._write(len(self._waiting))

    def _place_of(self, unix_ns: int) -> int:
        return bisect_left(self._waiting, (unix_ns,))

    def _write(self, count: int) -> None:
        write = self._writer.write
        for unix_ns, _, connection, message in self._waiting[:count]:
            write(connection, unix_ns, message)
        del self._waiting[:count]
        self._waiting_bytes = sum(len(message) for *_, message in self._waiting)


@contextmanager
def new_bag(folder: Path) -> Generator[Bag]:
    """Make a bag, which is complete when the block ends without an error.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        bag = Bag(writer)
        yield bag
        bag.write_all()
