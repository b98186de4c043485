"""Reduces the streams that one browser asked for to its pixels."""

from __future__ import annotations

import struct

from pydantic import BaseModel, ConfigDict, Field

from biosensor_gateway.agent.feed_frames import Samples
from biosensor_gateway.page.history import KEPT_S, History

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
