"""The WebSocket `/live`: traces as binary pictures, everything else as JSON."""

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

from biosensor_gateway.agent.feed_frames import Samples
from biosensor_gateway.agent.rate_meter import STALE_AFTER_S
from biosensor_gateway.page.static_files import LIVE

KEPT_S = 60.0
HOLDS_S = 30.0
"""How long a heart rate or another value of a body is of now that comes when it comes."""


def is_of_now(age_s: float | None, *, is_regular: bool, is_signal: bool) -> bool:
    """Whether the newest sample of a stream that goes on is that of now.

    Parameters
    ----------
    age_s
        Of the sample; None if there is none.
    is_regular
        Whether the stream has a rate.
    is_signal
        Whether it tells of a body. What it tells of the device itself holds until it changes.
    """
    if age_s is None:
        return False
    if is_regular:
        return age_s < STALE_AFTER_S
    return not is_signal or age_s < HOLDS_S


class History:
    """What came last, by source_id.

    Parameters
    ----------
    kept_s
        For how long it is kept.
    """

    def __init__(self, kept_s: float = KEPT_S) -> None:
        self._kept_s = kept_s
        self._chunks: dict[str, deque[Samples]] = {}

    def add(self, samples: Samples) -> None:
        """Keep what has come; forget what is too old."""
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
        """Forget all other streams."""
        for name in self._chunks.keys() - source_ids:
            del self._chunks[name]

    def forget(self, source_ids: Collection[str]) -> None:
        """Forget these streams."""
        for name in source_ids & self._chunks.keys():
            del self._chunks[name]

    def newest(self, source_id: str) -> tuple[float, list[float | None]] | None:
        """Return stamp and values of the newest sample; None if there is none."""
        kept = self._chunks.get(source_id)
        if not kept:
            return None
        last = kept[-1]
        # JSON knows neither NaN nor infinity.
        values = [float(each) if math.isfinite(each) else None for each in last.values[-1]]
        return float(last.stamps[-1]), values

    def since(self, source_id: str, begin_s: float) -> Iterator[Samples]:
        """Yield what came after an LSL time."""
        for each in self._chunks.get(source_id, ()):
            if each.stamps[-1] > begin_s:
                yield each


class Traces:
    """Keeps samples, and gives them to the browsers; on the loop of the server alone.

    Parameters
    ----------
    kept_s
        For how long samples are kept.

    Attributes
    ----------
    screens
        One a browser.
    opened
        How many there have been.
    """

    def __init__(self, kept_s: float = KEPT_S) -> None:
        self.history = History(kept_s)
        self.screens: set[Screen] = set()
        self.opened = 0

    def take(self, samples: Samples) -> None:
        """Keep what came, and give it to the browsers that show it."""
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
        """Forget a browser."""
        self.screens.discard(screen)

    @property
    def wanted(self) -> frozenset[str]:
        """The streams that some browser shows."""
        return frozenset[str]().union(*(screen.streams for screen in self.screens))


MAX_STREAMS = 200
_HEAD = struct.Struct("<Idd")


class View(BaseModel):
    """What a browser asks for.

    Attributes
    ----------
    generation
        Number of this request; it is in each answer.
    streams
        source_ids.
    window_s
        Seconds from edge to edge.
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
    """Collects what the next picture of one browser needs.

    What does not fit the screen any more is left out, however slow the browser is: a trace
    never has more bins than pixels.

    Parameters
    ----------
    history
        What came before the browser asked.
    """

    def __init__(self, history: History) -> None:
        self._history = history
        self._view: View | None = None
        self._waiting: dict[str, list[Samples]] = {}
        self._begin_s: float | None = None

    def show(self, view: View, now: float) -> None:
        """Take a new request; the next picture has what the window already covers.

        Parameters
        ----------
        now
            LSL time in seconds.
        """
        self._view = view
        # The page counts pixels from here, in numbers that JavaScript has exactly.
        self._begin_s = now - KEPT_S
        since_s = now - view.window_s
        self._waiting = {
            name: list(self._history.since(name, since_s)) for name in dict.fromkeys(view.streams)
        }

    @property
    def is_asked(self) -> bool:
        """Whether the browser has said what it shows."""
        return self._view is not None

    @property
    def streams(self) -> tuple[str, ...]:
        """What it shows."""
        return () if self._view is None else self._view.streams

    def add(self, samples: Samples) -> None:
        """Take in what a stream has sent."""
        waiting = self._waiting.get(samples.source_id)
        if waiting is None or self._view is None:
            return
        waiting.append(samples)
        # A browser that does not fetch its pictures must not fill the memory.
        while waiting[0].stamps[-1] < samples.stamps[-1] - self._view.window_s:
            waiting.pop(0)

    def picture(self, now: float) -> bytes | None:
        """Return what is new since the last picture; None while nothing was asked for.

        ::

            generation  uint32
            now         float64, LSL time in seconds
            bin_s       float64, width of a pixel; pixels count from LSL time `begin`
            ...         one block for each stream that has something new, see `bins.packed`

        A pixel may come again, with what was measured in it since.
        """
        if self._view is None or self._begin_s is None:
            return None
        # They bring numpy, and there is something to show before.
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
"""Code with which a WebSocket is closed because somebody has ended the page."""
PICTURES_HZ = 20
STATUS_EVERY = 10
"""Pictures from one status to the next: twice a second."""


def live(source: Source, more: Callable[[], BaseModel]) -> ASGIApp:
    """Return the WebSocket.

    Parameters
    ----------
    more
        Says what else the page shows, twice a second.
    """

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
        # Who asks for something that cannot be shown is not the page, and is let go.
        while True:
            screen.show(View.model_validate_json(await socket.receive_text()), source.now())
    with contextlib.suppress(RuntimeError):
        await socket.close()


async def _send(
    socket: WebSocket, source: Source, screen: Screen, more: Callable[[], BaseModel]
) -> None:
    """Send pictures; a browser that is slow gets fewer of them, and nothing piles up here."""
    count, next_s, told = 0, time.monotonic(), source.turns
    while not source.has_ended:
        if count % STATUS_EVERY == 0 or source.turns != told:
            told = source.turns
            await socket.send_text(more().model_dump_json())
        if screen.is_asked and (picture := screen.picture(source.now())) is not None:
            await socket.send_bytes(picture)
        count += 1
        # What making and sending one takes is not on top; one that is late is not caught up.
        now_s = time.monotonic()
        next_s = max(next_s + 1 / PICTURES_HZ, now_s)
        await asyncio.sleep(next_s - now_s)
    await socket.close(ENDED)


class Source(Protocol):
    """Where the page has its streams from: an agent's memory, or the network.

    Attributes
    ----------
    traces
        What came; the source adds to it.
    has_ended
        Whether somebody has ended the page.
    turns
        How often all has changed, so that nobody who looks should wait for the next status.
    """

    traces: Traces
    has_ended: bool
    turns: int

    def now(self) -> float:
        """Return the LSL time in seconds."""
        ...
