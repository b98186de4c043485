"""Sends the devices' samples to programs on this computer that show them.

The feed takes samples from the agent's memory: one more LSL inlet on each stream would double what
the agent sends. A slow reader loses frames, but does not delay others.
"""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import AsyncGenerator, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from biosensor_common import naming
from biosensor_common.errors import TransportError, TransportReason
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.device_states import identity_of
from biosensor_gateway.agent.feed_frames import FrameKind, dropped_frame, frame, samples_frame
from biosensor_gateway.streaming.sink import DeviceSink

MAX_READERS = 8
MAX_WAITING_BYTES = 4_000_000
"""Size of one reader's queue; some ten seconds of seven devices."""
FLUSH_S = 0.04
_MOST_NOTED = 4096
"""Samples that may wait before frames are made; readers usually ask for frames long before."""


class Feed:
    """Samples and status for all readers, with a queue for each."""

    def __init__(self) -> None:
        self._readers: set[ReaderQueue] = set()
        self._noted: list[tuple[DeviceIdentity, str, ArrayLike, Sequence[float]]] = []
        self._noted_samples = 0
        # For new readers: of a stream that tells changes the newest sample may be hours old.
        self._newest: dict[tuple[DeviceIdentity, str], tuple[ArrayLike, Sequence[float]]] = {}
        self._status: Mapping[str, Any] | None = None

    def watch(self, sink: DeviceSink) -> None:
        """Begin to send a device's samples."""

        def note(data_name: str, samples: ArrayLike, stamps: Sequence[float]) -> None:
            self._newest[sink.identity, data_name] = samples, stamps
            # Frames are made later, because the device's next packet waits for this call.
            if self._readers:
                self._noted.append((sink.identity, data_name, samples, stamps))
                self._noted_samples += len(stamps)
                if self._noted_samples > _MOST_NOTED:
                    self._make_frames()

        sink.tap = note

    def send_status(self, status: Mapping[str, Any]) -> None:
        """Send the agent's status."""
        self._status = status
        present = {identity_of(each) for each in status.get("devices", ())}
        self._newest = {key: each for key, each in self._newest.items() if key[0] in present}
        if self._readers:
            self._make_frames()
            message = _status_frame(status)
            for reader in self._readers:
                reader.put(message, 0)

    async def conversation(self, _arguments: Mapping[str, Any]) -> AsyncGenerator[bytes]:
        """Yield frames for one reader, until it is closed.

        Raises
        ------
        TransportError
            ``BUSY`` if there are too many readers.
        """
        if len(self._readers) >= MAX_READERS:
            message = f"{MAX_READERS} programs already show the agent's data; close one"
            raise TransportError(TransportReason.BUSY, message)
        reader = ReaderQueue()
        # A new reader need not wait up to a second for the next status.
        if self._status is not None:
            reader.put(_status_frame(self._status), 0)
        for message in self._newest_frames():
            reader.put(message, 0)
        self._readers.add(reader)
        try:
            while True:
                self._make_frames()
                yield reader.take()
                await asyncio.sleep(FLUSH_S)
        finally:
            self._readers.discard(reader)

    def _newest_frames(self) -> Iterator[bytes]:
        devices = () if self._status is None else self._status.get("devices", ())
        shown = {identity_of(each) for each in devices if not each["paused"]}
        for (identity, data_name), (samples, stamps) in self._newest.items():
            if identity in shown:
                source = naming.source_id(identity, data_name)
                yield samples_frame(source, stamps[-1:], np.asarray(samples)[-1:])

    def _make_frames(self) -> None:
        for identity, data_name, samples, stamps in self._noted:
            message = samples_frame(naming.source_id(identity, data_name), stamps, samples)
            for reader in self._readers:
                reader.put(message, len(stamps))
        self._noted.clear()
        self._noted_samples = 0


def _status_frame(status: Mapping[str, Any]) -> bytes:
    return frame(FrameKind.STATUS, json.dumps(status).encode())


class ReaderQueue:
    """Frames for one reader; when there are too many, the oldest are dropped and counted."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[bytes, int]] = deque()
        self._bytes = 0
        self._dropped = 0

    def put(self, message: bytes, samples: int) -> None:
        """Add a frame with this number of samples."""
        self._waiting.append((message, samples))
        self._bytes += len(message)
        while self._bytes > MAX_WAITING_BYTES:
            oldest, lost = self._waiting.popleft()
            self._bytes -= len(oldest)
            self._dropped += lost

    def take(self) -> bytes:
        """Remove and return all frames, preceded by the number of dropped samples."""
        messages = [message for message, _ in self._waiting]
        if self._dropped:
            messages.insert(0, dropped_frame(self._dropped))
        self._waiting.clear()
        self._bytes = self._dropped = 0
        return b"".join(messages)
