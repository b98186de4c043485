"""The WebSocket `/live`: sends traces as binary data, and everything else as JSON."""

from __future__ import annotations

import asyncio
import contextlib
import math
import struct
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator
from typing import Protocol

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.routing import Router, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from biosensor_common.stream_header import stale_after_s
from biosensor_gateway.agent.feed_frames import Samples
from biosensor_gateway.page.static_files import LIVE

KEPT_S = 60.0
HOLDS_S = 30.0
"""How long a value of an irregular stream about the body, such as a heart rate, is current."""


def is_of_now(age_s: float | None, *, nominal_hz: float, is_signal: bool) -> bool:
    """Whether the newest sample of a stream is current.

    Parameters
    ----------
    age_s
        Age of the sample; None if there is none.
    nominal_hz
        Nominal rate of the stream; 0 for irregular ones.
    is_signal
        Whether it is a signal of the body; a value of the device is current until it changes.
    """
    if age_s is None:
        return False
    if nominal_hz > 0:
        return age_s < stale_after_s(nominal_hz)
    return not is_signal or age_s < HOLDS_S


class History:
    """Stores the newest samples by source_id."""

    def __init__(self, kept_s: float = KEPT_S) -> None:
        self._kept_s = kept_s
        self._chunks: dict[str, deque[Samples]] = {}

    def add(self, samples: Samples) -> None:
        """Store samples, and discard those that are too old."""
        if not len(samples.stamps):
            return
        kept = self._chunks.setdefault(samples.source_id, deque())
        if kept and kept[-1].values.shape[1] != samples.values.shape[1]:
            kept.clear()
        kept.append(samples)
        oldest = samples.stamps[-1] - self._kept_s
        while kept[0].stamps[-1] < oldest:
            kept.popleft()

    def keep_only(self, source_ids: Collection[str]) -> None:
        """Discard all other streams."""
        for name in self._chunks.keys() - source_ids:
            del self._chunks[name]

    def forget(self, source_ids: Collection[str]) -> None:
        """Discard these streams."""
        for name in source_ids & self._chunks.keys():
            del self._chunks[name]

    def newest(self, source_id: str) -> tuple[float, list[float | None]] | None:
        """Return stamp and values of the newest sample; None if there is none."""
        kept = self._chunks.get(source_id)
        if not kept:
            return None
        last = kept[-1]
        # JSON has neither NaN nor infinity.
        values = [float(each) if math.isfinite(each) else None for each in last.values[-1]]
        return float(last.stamps[-1]), values

    def since(self, source_id: str, begin_s: float) -> Iterator[Samples]:
        """Yield chunks with samples after an LSL time."""
        for each in self._chunks.get(source_id, ()):
            if each.stamps[-1] > begin_s:
                yield each


class Traces:
    """Stores samples, and passes them to the browsers; used only on the server's loop."""

    def __init__(self, kept_s: float = KEPT_S) -> None:
        self.history = History(kept_s)
        self.screens: set[Screen] = set()
        self.opened = 0

    def take(self, samples: Samples) -> None:
        """Store samples, and pass them to the browsers that show their stream."""
        self.history.add(samples)
        for screen in self.screens:
            screen.add(samples)

    def open(self) -> Screen:
        """Add a browser."""
        screen = Screen(self.history)
        self.screens.add(screen)
        self.opened += 1
        return screen

    def close(self, screen: Screen) -> None:
        """Remove a browser."""
        self.screens.discard(screen)

    @property
    def wanted(self) -> frozenset[str]:
        """The streams that any browser shows."""
        return frozenset[str]().union(*(screen.streams for screen in self.screens))


MAX_STREAMS = 200
_HEAD = struct.Struct("<Idd")


class View(BaseModel):
    """A browser's request for traces.

    Attributes
    ----------
    generation
        Number of this request; it is in each answer.
    streams
        source_ids.
    window_s
        Time span of a trace in seconds.
    pixels
        Width of a trace.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    generation: int = Field(ge=0, lt=2**32)
    streams: tuple[str, ...] = Field(max_length=MAX_STREAMS)
    window_s: float = Field(ge=1, le=KEPT_S)
    pixels: int = Field(ge=10, le=4000)

    @property
    def bin_s(self) -> float:
        """Width of a pixel in seconds."""
        return self.window_s / self.pixels


class Screen:
    """Collects the samples for the next frame of one browser.

    A trace never has more bins than pixels: for a slow browser, samples that have left the window
    are discarded.
    """

    def __init__(self, history: History) -> None:
        self._history = history
        self._view: View | None = None
        self._waiting: dict[str, list[Samples]] = {}
        self._begin_s: float | None = None

    def show(self, view: View, now: float) -> None:
        """Store a new request; the next frame covers the whole window.

        Parameters
        ----------
        now
            LSL time in seconds.
        """
        self._view = view
        # The page counts pixels from here, so that JavaScript's numbers are exact.
        self._begin_s = now - KEPT_S
        since_s = now - view.window_s
        self._waiting = {
            name: list(self._history.since(name, since_s)) for name in dict.fromkeys(view.streams)
        }

    @property
    def is_asked(self) -> bool:
        """Whether the browser has sent a request."""
        return self._view is not None

    @property
    def streams(self) -> tuple[str, ...]:
        """The streams that the browser shows."""
        return () if self._view is None else self._view.streams

    def add(self, samples: Samples) -> None:
        """Add samples for the next frame."""
        waiting = self._waiting.get(samples.source_id)
        if waiting is None or self._view is None:
            return
        waiting.append(samples)
        # A browser that does not fetch its frames must not fill the memory.
        while waiting[0].stamps[-1] < samples.stamps[-1] - self._view.window_s:
            waiting.pop(0)

    def picture(self, now: float) -> bytes | None:
        """Return the samples since the last frame as bins; None before the first request.

        ::

            generation  uint32
            now         float64, LSL time in seconds
            bin_s       float64, width of a pixel; pixels count from LSL time `begin`
            ...         one block for each stream with new samples, see `downsampling.packed`

        A pixel may be sent again with further samples.
        """
        if self._view is None or self._begin_s is None:
            return None
        # Imported late, because it needs numpy, and the page shows devices before.
        from biosensor_gateway.page.downsampling import binned, newest_bins, packed

        bin_s = self._view.bin_s
        begin = int(self._begin_s // bin_s)
        blocks = [_HEAD.pack(self._view.generation, now - begin * bin_s, bin_s)]
        for index, name in enumerate(self._waiting):
            bins = binned(self._waiting[name], bin_s)
            if bins is not None and bins.numbers[0] >= begin:
                blocks.append(packed(index, newest_bins(bins, self._view.pixels), begin))
            self._waiting[name] = []
        return b"".join(blocks)


ENDED = 4000
"""Code with which a WebSocket is closed when the page is ended."""
PICTURES_HZ = 20
STATUS_EVERY = 10
"""Number of pictures between two statuses: two statuses per second."""


def live(source: Source, more: Callable[[], BaseModel]) -> ASGIApp:
    """Return the application that serves the WebSocket."""

    async def show(socket: WebSocket) -> None:
        await socket.accept()
        screen = source.traces.open()
        sending = asyncio.create_task(_send(socket, source, screen, more))
        try:
            await _receive(socket, source, screen)
        finally:
            source.traces.close(screen)
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)

    return Router([WebSocketRoute(LIVE, show)])


async def _receive(socket: WebSocket, source: Source, screen: Screen) -> None:
    with contextlib.suppress(WebSocketDisconnect, ValidationError, KeyError):
        # A client with an invalid request is not our page, and is disconnected.
        while True:
            screen.show(View.model_validate_json(await socket.receive_text()), source.now())
    with contextlib.suppress(RuntimeError):
        await socket.close()


async def _send(
    socket: WebSocket, source: Source, screen: Screen, more: Callable[[], BaseModel]
) -> None:
    """Send frames and statuses; a slow browser gets fewer of them."""
    count, next_s, sent_turns = 0, time.monotonic(), source.turns
    while not source.has_ended:
        if count % STATUS_EVERY == 0 or source.turns != sent_turns:
            sent_turns = source.turns
            await socket.send_text(more().model_dump_json())
        if screen.is_asked and (picture := screen.picture(source.now())) is not None:
            await socket.send_bytes(picture)
        count += 1
        # The interval includes the time for making and sending; missed pictures are skipped.
        now_s = time.monotonic()
        next_s = max(next_s + 1 / PICTURES_HZ, now_s)
        await asyncio.sleep(next_s - now_s)
    await socket.close(ENDED)


class Source(Protocol):
    """The source of the page's streams: an agent's feed, or the network."""

    traces: Traces
    has_ended: bool
    turns: int  # Counts changes after which the status is sent at once.

    def now(self) -> float:
        """Return the LSL time in seconds."""
        ...
