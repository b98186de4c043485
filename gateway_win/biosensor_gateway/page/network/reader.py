"""The one thread that looks for streams and reads those that are looked at."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pylsl
import structlog

from biosensor_common.lsl.predicates import Predicate
from biosensor_common.sender_clocks import SenderClocks
from biosensor_gateway.agent.feed_frames import Samples
from biosensor_gateway.page.network.descriptions import Descriptions
from biosensor_gateway.page.network.inlets import Inlets
from biosensor_gateway.page.network.listing import Listing
from biosensor_gateway.page.network.models import NetworkView
from biosensor_gateway.page.network.receiver import Receiver
from biosensor_gateway.page.network.stream import NetworkStream
from biosensor_gateway.page.network.viewer import Viewer
from biosensor_gateway.page.network.windows import chosen, key_of, measured_rate, window

READ_S = 0.05
LOOK_EVERY = 10
"""Readings from one look at the network to the next: twice a second."""
CLOCKS_S = 30.0
"""Clocks drift by some milliseconds meanwhile; a pixel has eleven."""
_THREADS = 8
_STOP_S = 2.0

_log = structlog.get_logger("biosensor_gateway.page")


class Reader:
    """Follows the streams of the network.

    Parameters
    ----------
    on_samples
        Is given what was read, in the reader's thread.
    wanted_streams
        Which streams are looked for; all by default.

    Attributes
    ----------
    wanted
        What the browsers show, see `key_of`; set by whoever knows.
    view
        What there is to say of all streams, made twice a second.
    """

    def __init__(
        self,
        on_samples: Callable[[list[Samples]], None],
        wanted_streams: Predicate | None = None,
    ) -> None:
        self.wanted: frozenset[str] = frozenset()
        self.view = NetworkView()
        self._on_samples = on_samples
        self._resolver = pylsl.ContinuousResolver(pred=wanted_streams)
        self._pool = ThreadPoolExecutor(_THREADS, thread_name_prefix="network")
        self._listing = Listing()
        self._descriptions = Descriptions(self._pool)
        self._inlets = Inlets(self._close, self._pool)
        self._viewer = Viewer()
        self._receivers: list[Receiver] = []
        self._clocks = SenderClocks(lambda: self._receivers, CLOCKS_S)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True, name="network reader")
        self._thread.start()

    def stop(self) -> None:
        """End all reading; inlets are closed on the way out."""
        self._stopping.set()
        # liblsl may hold it; the process ends in spite of it.
        self._thread.join(_STOP_S)
        self._clocks.stop()
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _run(self) -> None:
        count = 0
        try:
            while not self._stopping.wait(READ_S):
                if count % LOOK_EVERY == 0:
                    self._look(pylsl.local_clock())
                count += 1
                self._read()
        except Exception:  # noqa: BLE001 - its view gets old, which the page says
            # nothing is dropped: the view gets old, which the page says
            _log.exception("the network is not looked at any more")

    def _look(self, now: float) -> None:
        for receiver in self._listing.update(self._resolver.results(), now):
            self._close(receiver)
        streams = self._listing.streams
        self._descriptions.update(streams.values(), now)
        self._inlets.update(streams, sorted(chosen(self.wanted)), now)
        self._receivers = [each.receiver for each in streams.values() if each.receiver]
        self.view = self._viewer.view(self._listing, self._inlets.refused, self.wanted, now)

    def _read(self) -> None:
        windows = chosen(self.wanted)
        samples: list[Samples] = []
        for stream in self._listing.streams.values():
            if stream.receiver is not None:
                samples += self._read_one(stream, stream.receiver, windows)
        if samples:
            self._on_samples(samples)

    def _read_one(
        self, stream: NetworkStream, receiver: Receiver, windows: dict[int, set[int]]
    ) -> list[Samples]:
        now = pylsl.local_clock()
        try:
            block = receiver.pull()
        except RuntimeError as error:
            # nothing is dropped: its state says that it is gone, or its note why
            self._inlets.drop(stream, now, error)
            return []  # nothing is dropped: as above
        if block is None:
            return []  # nothing is dropped: nothing has come
        stream.lost_s = None
        stream.received.placer.correction = receiver.correction
        times = stream.received.take(block, now)
        if not len(stream.received.values):
            return []  # nothing is dropped: it is text, which `take` keeps
        rate = max(stream.core.rate, measured_rate(times))
        firsts = [each for each in windows.get(stream.number, ()) if each < block.samples.shape[1]]
        return [
            window(key_of(stream.number, first), times, block.samples, first, rate)
            for first in firsts
        ]

    def _close(self, receiver: Receiver) -> None:
        # liblsl waits for its own threads.
        self._pool.submit(receiver.close)
