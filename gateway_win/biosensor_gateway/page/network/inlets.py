"""Decides which streams are received: those that somebody looks at, and not too many."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor

from pylsl import util

from biosensor_gateway.page.network.losses import is_counters
from biosensor_gateway.page.network.receiver import CLOCK_WITHIN_S, Receiver
from biosensor_gateway.page.network.stream import NetworkStream

MAX_INLETS = 64
"""Each costs its sender as much as one more recorder."""
LINGER_S = 5.0
"""Whoever scrolls comes back; opening again takes longer."""
_RETRY_S = 2.0
_UNSEEN_S = 2.0
# Until samples are pulled, nothing tells that the outlet is dead.
_SETTLED_S = CLOCK_WITHIN_S + 1.0


class Inlets:
    """Opens and closes receivers.

    Parameters
    ----------
    close
        Closes one, somewhere where it may take its time.
    pool
        Opens them.

    Attributes
    ----------
    refused
        How many streams are looked at and not received, because there are too many.
    """

    def __init__(self, close: Callable[[Receiver], object], pool: Executor) -> None:
        self.refused = 0
        self._close, self._pool = close, pool
        self._wanted_s: dict[NetworkStream, float] = {}

    def update(
        self, streams: Mapping[int, NetworkStream], numbers: Iterable[int], now: float
    ) -> None:
        """Receive the streams of these numbers, and what their agents count."""
        wanted = [streams[number] for number in numbers if number in streams]
        if any(stream.is_ours for stream in wanted):
            wanted += [stream for stream in streams.values() if is_counters(stream)]
        self._wanted_s.update(dict.fromkeys(wanted, now))
        self._close_unwanted(streams, now)
        self.refused = 0
        open_now = sum(stream.receiver is not None for stream in streams.values())
        for stream in dict.fromkeys(wanted):
            if stream.receiver is None and not self._has_to_wait(stream, now):
                if open_now < MAX_INLETS:
                    open_now += 1
                    self._open(stream)
                else:
                    self.refused += 1
            elif stream.receiver is not None and stream.receiver.age_s > _SETTLED_S:
                stream.lost_s = None

    def drop(self, stream: NetworkStream, now: float, error: RuntimeError) -> None:
        """Take note that a stream is lost, or that liblsl cannot open it."""
        if not isinstance(error, util.LostError | util.TimeoutError):
            stream.note = f"LSL cannot open it ({error})"
        stream.lost_s = now
        if stream.receiver is not None:
            self._close(stream.receiver)
        stream.receiver = None

    def _close_unwanted(self, streams: Mapping[int, NetworkStream], now: float) -> None:
        for stream, wanted_s in list(self._wanted_s.items()):
            if now - wanted_s > LINGER_S or stream.number not in streams:
                del self._wanted_s[stream]
                if stream.receiver is not None:
                    self._close(stream.receiver)
                    stream.receiver = None

    def _has_to_wait(self, stream: NetworkStream, now: float) -> bool:
        """Whether opening it is of no use yet: it is gone, or was lost a moment ago."""
        is_lost = stream.lost_s is not None and now - stream.lost_s < _RETRY_S
        is_unseen = now - stream.seen_s > _UNSEEN_S
        return stream.header is None or is_lost or is_unseen

    def _open(self, stream: NetworkStream) -> None:
        stream.received.begin(stream.core, is_ours=stream.is_ours)
        stream.receiver = Receiver(stream.info, stream.core, self._pool)
