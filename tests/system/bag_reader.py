"""Reads a bag of stamped topics with nothing but what the bag itself holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader

from tests.system.tracks import NS_PER_S, Times, Track

_OURS = "biosensor_msgs/msg/"


@dataclass(frozen=True)
class RecordedTopic:
    """All messages of one stamped topic, taken apart into samples."""

    track: Track
    # sequences, arrivals_ns: for each sample its number, and the system time at which its message
    # came.
    sequences: NDArray[np.uint64]
    arrivals_ns: Times
    frame_ids: frozenset[str]  # All that were in its messages.


class _Collector:
    """Messages of one topic."""

    def __init__(self) -> None:
        self._times: list[Times] = []
        self._values: list[NDArray[Any]] = []
        self._sequences: list[NDArray[np.uint64]] = []
        self._arrivals: list[Times] = []
        self._frame_ids: set[str] = set()
        self._labels: set[tuple[str, ...]] = set()
        self._units: set[tuple[str, ...]] = set()

    def add(self, message: Any, arrival_ns: int) -> None:
        stamp = message.header.stamp
        start_ns = stamp.sec * NS_PER_S + stamp.nanosec
        offsets = getattr(message, "offsets_ns", np.zeros(1, np.int64))
        self._times.append(start_ns + offsets)
        self._values.append(_values(message, len(offsets)))
        self._sequences.append(message.sequence + np.arange(len(offsets), dtype=np.uint64))
        self._arrivals.append(np.full(len(offsets), arrival_ns, np.int64))
        self._frame_ids.add(message.header.frame_id)
        self._labels.add(tuple(getattr(message, "labels", ())))
        self._units.add(tuple(getattr(message, "units", ())))

    def topic(self) -> RecordedTopic:
        """Return what came.

        Raises
        ------
        ValueError
            If labels or units changed.
        """
        ((labels,), (units,)) = self._labels, self._units
        track = Track(np.concatenate(self._times), np.concatenate(self._values), labels, units)
        return RecordedTopic(
            track,
            np.concatenate(self._sequences),
            np.concatenate(self._arrivals),
            frozenset(self._frame_ids),
        )


def _values(message: Any, samples: int) -> NDArray[Any]:
    if isinstance(message.data, str):
        return np.array([[message.data]], object)
    filled = message.data if len(message.data) else message.integers
    assert not (len(message.data) and len(message.integers)), message
    return filled.reshape(samples, len(message.labels))


def read(bag: Path) -> Mapping[str, RecordedTopic]:
    """Return the stamped topics of a bag on which something came."""
    topics: dict[str, _Collector] = {}
    with AnyReader([bag]) as reader:
        stamped = [each for each in reader.connections if each.msgtype.startswith(_OURS)]
        # Without any it would give all.
        for connection, arrival_ns, data in reader.messages(stamped) if stamped else ():
            message = reader.deserialize(data, connection.msgtype)
            topics.setdefault(connection.topic, _Collector()).add(message, arrival_ns)
    return {name: collector.topic() for name, collector in topics.items()}
