"""The virtual device itself: a source, a conversation and a link in one thread."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from math import inf

import numpy as np

from biosensor_gateway.devices.zephyr.simulator.session import Session
from biosensor_gateway.devices.zephyr.simulator.sources import Outgoing, Source
from biosensor_gateway.devices.zephyr.simulator.wire import Packet, Request
from biosensor_gateway.simulation.serial_links import Link

PutOnLink = Callable[[Outgoing, bool], None]

_DRAIN_CHECK_S = 0.02
_HANG_UP_S = 1.0


class SimulatedDevice:
    """What one thread runs: `wait`, then `step`, for ever.

    Parameters
    ----------
    source, session, link
        What it measures, how it converses, where the host is.
    seed
        Of garbage and flipped bits.
    kept_packets
        Limit of ``sent`` and ``requests``; None = all.
    put_on_link
        Told of each frame of the source that was due and enabled, and whether the link
        took it intact; called in the device's thread.

    Attributes
    ----------
    stalled
        Nothing is sent, nothing is heard.
    corrupts_next
        The next frame gets a flipped bit.
    sent, requests
        What the link took of the source's frames; what was heard.
    dropped_frames
        Frames that the link had no room for.
    """

    def __init__(
        self,
        source: Source,
        session: Session,
        link: Link,
        seed: int,
        kept_packets: int | None,
        put_on_link: PutOnLink | None = None,
    ) -> None:
        self.source = source
        self.session = session
        self.link = link
        self.stalled = False
        self.corrupts_next = False
        self.sent: deque[Outgoing] = deque(maxlen=kept_packets)
        self.requests: deque[Request] = deque(maxlen=kept_packets)
        self.dropped_frames = 0
        self._put_on_link = put_on_link
        self._rng = np.random.default_rng(seed)
        self._reopens_at: float | None = None

    def power_on(self) -> None:
        """Become reachable and begin to measure."""
        self.link.open()
        self.source.power_on(time.monotonic())

    def wait(self) -> bytes:
        """Wait until something is due or heard; return what was heard."""
        return self.link.exchange(self._next_due() - time.monotonic())

    def step(self, heard: bytes) -> None:
        """Take what the host said; say what is due."""
        now = time.monotonic()
        self._reopen_if_due(now)
        self._hear(heard, now)
        self._speak(now)

    def hang_up(self, seconds: float) -> None:
        """Drop the link for so long; what the host switched on is forgotten."""
        self.link.close()
        self._reopens_at = time.monotonic() + seconds
        self._end_connection()

    def restore(self) -> None:
        """End a `hang_up` now."""
        self._reopen_if_due(inf)

    def send_garbage(self, count: int) -> None:
        """Send so many random bytes."""
        if self._reaches_host:
            self.link.write(self._rng.bytes(count))

    @property
    def _reaches_host(self) -> bool:
        return self.session.active and self._reopens_at is None and not self.stalled

    def _next_due(self) -> float:
        now = time.monotonic()
        if self.source.hangs_up(now):
            return now + _DRAIN_CHECK_S
        reopens_at = inf if self._reopens_at is None else self._reopens_at
        return min(self.session.next_due(), self.source.next_due(), reopens_at)

    def _hear(self, heard: bytes, now: float) -> None:
        if heard and self._reopens_at is None and not self.stalled:
            self.requests.extend(self.session.hear(heard, now))
        if self.session.host_is_lost(now):
            self._end_connection()

    def _speak(self, now: float) -> None:
        for data in self.session.say(now):
            is_lifesign = data[1] == Packet.LIFESIGN
            if not (is_lifesign and self.source.speaks_lifesigns):
                self._send(Outgoing(data))
        for frame in self.source.poll(now, self.session.enabled):
            if (sent := self._send(frame)) is not None:
                self.sent.append(sent)
            if self._put_on_link is not None:
                self._put_on_link(frame, sent is not None and not sent.corrupted)
        if self.source.hangs_up(now) and self.link.drained():
            self.hang_up(_HANG_UP_S)

    def _send(self, frame: Outgoing) -> Outgoing | None:
        """Write a frame if it reaches the host; return it as it was written."""
        if not self._reaches_host:
            return None
        if self.corrupts_next and _is_frame(frame.data):
            frame = replace(frame, data=self._flip_a_bit(frame.data), corrupted=True)
        if not self.link.write(frame.data):
            self.dropped_frames += 1
            return None
        self.corrupts_next = self.corrupts_next and not frame.corrupted
        return frame

    def _flip_a_bit(self, frame: bytes) -> bytes:
        # Id and length are outside the check: a flip there might pass for another frame.
        first, last = 3, len(frame) - 2
        bit = int(self._rng.integers(8 * first, 8 * (last + 1)))
        damaged = bytearray(frame)
        damaged[bit // 8] ^= 1 << bit % 8
        return bytes(damaged)

    def _reopen_if_due(self, now: float) -> None:
        if self._reopens_at is not None and self._reopens_at <= now:
            self._reopens_at = None
            self.link.open()

    def _end_connection(self) -> None:
        self.session.forget()
        self.source.connection_ended()


def _is_frame(data: bytes) -> bool:
    return len(data) > 4 and len(data) == data[2] + 5
