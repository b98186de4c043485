"""Finds the streams of the network on one thread, and receives those that a browser shows."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import pylsl
import structlog
from pylsl import local_clock

from biosensor_common.lsl.api_file import LSL_BASE_PORT, LSL_DISCOVERY_PORT
from biosensor_common.lsl.header import header_or_foreign
from biosensor_common.lsl.inlet import Connection, fetch_description
from biosensor_common.lsl.network import Network, configure_lsl, numbered
from biosensor_common.lsl.predicates import EVERYTHING, Predicate
from biosensor_common.lsl.sender_clocks import SenderClocks
from biosensor_common.stream_header import CoreFields, StreamHeader, foreign_header
from biosensor_gateway.agent.feed_frames import Samples
from biosensor_gateway.page.downsampling import chosen, key_of, measured_rate, window
from biosensor_gateway.page.live_feed import Traces
from biosensor_gateway.page.models import NetworkView
from biosensor_gateway.page.network.network_stream import NetworkStream, Receiver
from biosensor_gateway.page.network.stream_list import Inlets, StreamList
from biosensor_gateway.page.network.view import Viewer
from biosensor_gateway.settings.models import LslSettings

KEPT_S = 15.0
"""The page draws ten seconds."""
_TOLD_EVERY_S = 0.1
_STOPPED_AFTER_S = 5.0
_STOPPED = "the streams are no longer observed; end this program and start it again"


class NetworkSource:
    """Shows the LSL streams that this computer receives; see `Source`.

    It configures LSL for this process, so that there can be only one, made before any other call
    of LSL.

    Parameters
    ----------
    lsl, settings
        LSL configuration, and the file that has it, which need not exist.

    Raises
    ------
    ConfigError
        If LSL's own settings are wrong.
    """

    def __init__(self, lsl: LslSettings, settings: Path) -> None:
        own = configure_lsl(lsl.overrides)
        self.traces = Traces(KEPT_S)
        self.has_ended = False
        self.turns = 0
        self._search = _search(lsl, settings, own)
        self._reader: Reader | None = None

    @staticmethod
    def now() -> float:
        """Return the LSL time in seconds."""
        return local_clock()

    def status(self) -> NetworkView:
        """Return the view of all streams; without streams if the reader has stopped."""
        view = NetworkView() if self._reader is None else self._reader.view
        if view.made_s and local_clock() - view.made_s > _STOPPED_AFTER_S:
            return NetworkView(problems=[_STOPPED], search=self._search)
        return view.model_copy(update={"search": self._search})

    async def run(self) -> None:
        """Follow the streams until cancelled."""
        self._reader = reader = Reader(into(self.traces))
        try:
            while True:
                reader.wanted = self.traces.wanted
                self.traces.history.keep_only(reader.wanted)
                await asyncio.sleep(_TOLD_EVERY_S)
        finally:
            reader.stop()


def into(traces: Traces) -> Callable[[list[Samples]], None]:
    """Return what passes a reader's samples to the traces, on the loop that runs now."""
    loop = asyncio.get_running_loop()

    def take(samples: list[Samples]) -> None:
        for each in samples:
            traces.take(each)

    def hand_over(samples: list[Samples]) -> None:
        # nothing is dropped: the loop may have ended a moment before the thread
        with contextlib.suppress(RuntimeError):
            loop.call_soon_threadsafe(take, samples)

    return hand_over


def _search(lsl: LslSettings, settings: Path, own: Path | None) -> list[str]:
    session = f"{lsl.session_id!r}" if lsl.session_id else "of LSL's own settings"
    peers = f", and asks {', '.join(lsl.known_peers)} directly" if lsl.known_peers else ""
    own_file = own or "no file, so the defaults"
    return [
        f"This page looks in the LSL session {session}{peers}.",
        f"LSL's own settings: {own_file}. This program's: {settings}, section [lsl].",
        "The senders must be running and use the same session.",
        "Run biosensor-gateway doctor here and on the sender's computer: it reports what is wrong.",
        f"Firewalls must allow UDP {LSL_DISCOVERY_PORT} and LSL's ports from {LSL_BASE_PORT}.",
        "Where multicast does not get through, name the sender in known_peers in section [lsl].",
    ]


READ_S = 0.05
LOOK_EVERY = 10
"""Number of readings between two looks at the network, which makes two looks per second."""
CLOCKS_S = 30.0
"""Interval of clock measurements: clocks drift by a few ms meanwhile, and a pixel has 11 ms."""
_THREADS = 8
_STOP_S = 2.0

_log = structlog.get_logger("biosensor_gateway.page")
TIMEOUT_S = 5.0
_RETRY_S = 10.0
_MOST_TRIES = 3


class Reader:
    """Finds streams on the network, and receives the wanted ones.

    Parameters
    ----------
    on_samples
        Called with samples, in the reader's thread.
    wanted_streams
        Selects the streams to find; all by default.
    """

    def __init__(
        self,
        on_samples: Callable[[list[Samples]], None],
        wanted_streams: Predicate | None = None,
    ) -> None:
        # Keys of the channels that browsers show, see `key_of`; set by the owner.
        self.wanted: frozenset[str] = frozenset()
        self.view = NetworkView()  # View of all streams, updated twice a second.
        self._on_samples = on_samples
        self._network = Network(wanted_streams or EVERYTHING)
        self._pool = ThreadPoolExecutor(_THREADS, thread_name_prefix="network")
        self._listing = StreamList()
        self._descriptions = Descriptions(self._pool)
        self._inlets = Inlets(self._close, self._pool)
        self._viewer = Viewer()
        self._connections: list[Connection] = []
        self._clocks = SenderClocks(lambda: self._connections, CLOCKS_S)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True, name="network reader")
        self._thread.start()

    def stop(self) -> None:
        """Stop receiving, and close the inlets."""
        self._stopping.set()
        # With a limit: liblsl may block the thread, which does not keep the process from ending.
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
            _log.exception("the network is no longer observed")

    def _look(self, now: float) -> None:
        for receiver in self._listing.update(self._network.streams(), now):
            self._close(receiver)
        streams = self._listing.streams
        self._descriptions.update(streams.values(), now)
        self._inlets.update(streams, sorted(chosen(self.wanted)), now)
        receivers = [each.receiver for each in streams.values() if each.receiver]
        self._connections = [each.connection for each in receivers]
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
        # In another thread, because liblsl waits for its own threads.
        self._pool.submit(receiver.close)


@dataclass(slots=True)
class _Reading:
    task: Future[tuple[StreamHeader, str]] | None = None
    not_before_s: float = 0.0
    tries: int = field(default=0)


class Descriptions:
    """Reads the full header of each outlet once, over a short connection without data."""

    def __init__(self, pool: Executor) -> None:
        self._pool = pool
        self._readings: dict[str, _Reading] = {}

    def update(self, streams: Iterable[NetworkStream], now: float) -> None:
        """Start reading the headers of new outlets, and assign those that were read."""
        unread = {each.uid: each for each in streams if not each.has_description}
        for uid, stream in unread.items():
            reading = self._readings.setdefault(uid, _Reading())
            if reading.task is not None and reading.task.done():
                self._settle(stream, reading, now)
            elif reading.task is None and now >= reading.not_before_s:
                reading.tries += 1
                reading.task = self._pool.submit(_read, stream.info, stream.core)
        for uid in self._readings.keys() - unread.keys():
            del self._readings[uid]

    def _settle(self, stream: NetworkStream, reading: _Reading, now: float) -> None:
        assert reading.task is not None
        try:
            header, note = reading.task.result()
            stream.header = numbered(header, stream.namesake)
            stream.note = note or stream.note
            stream.has_description = True
        except RuntimeError:
            # nothing is dropped: the outlet may have ended, or its computer does not answer
            reading.task, reading.not_before_s = None, now + _RETRY_S
            stream.header = stream.header or numbered(foreign_header(stream.core), stream.namesake)
            if reading.tries >= _MOST_TRIES:
                stream.has_description = True
                stream.note = "its description could not be read: its computer does not answer"


def _read(info: pylsl.StreamInfo, core: CoreFields) -> tuple[StreamHeader, str]:
    """Return the header, and its problem.

    Raises
    ------
    RuntimeError
        If it is not received in time, or the stream is lost.
    """
    header, why = header_or_foreign(fetch_description(info, TIMEOUT_S), core)
    # nothing is dropped: it is shown as a stream of another program, with this note
    return header, f"its description is not usable: {why}" if why else ""
