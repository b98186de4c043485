"""One stream on its way from the file to its outlet."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.contents.stream import Samples
from biosensor_gateway.recording.replay.outlet import Block, PlayedOutlet
from biosensor_gateway.recording.replay.timeline import Timeline


class Track:
    """Reads a stream chunk by chunk, the next one as soon as the last one has been sent.

    Parameters
    ----------
    blocks
        Its samples in the order of the file.

    Attributes
    ----------
    due_s
        When its next sample was recorded, infinite after the last. One whose stamp runs back
        goes out with the one before it.

    Raises
    ------
    RecordingError
        If the file cannot be read any more, here and in `send`.
    """

    def __init__(self, outlet: PlayedOutlet, blocks: Iterator[Samples]) -> None:
        self._outlet, self._blocks = outlet, blocks
        self._samples: Samples | None = None
        self._block: Block | None = None
        self._stamps = np.empty(0)
        self._due: list[float] = []
        self._at = 0
        self.due_s = -math.inf
        self._read()

    def send(self, until_s: float, timeline: Timeline) -> NDArray[np.float64]:
        """Send what is due of the present chunk.

        Parameters
        ----------
        until_s
            Time of the recording, from `due_s` on.

        Returns
        -------
        ndarray of float64, shape (n_samples,)
            Stamps of what was sent.
        """
        if self._samples is None:
            return np.empty(0)
        if self._block is None:
            self._stamps = timeline.stamps(self._samples.times)
            self._block = self._outlet.block(self._samples, self._stamps)
        begin, end = self._at, bisect_right(self._due, until_s, self._at)
        self._block.push(begin, end)
        stamps = self._stamps[begin:end]
        self._at = end
        if end < len(self._due):
            self.due_s = self._due[end]
        else:
            self._read()
        return stamps

    def _read(self) -> None:
        self._samples, self._block, self._at = next(self._blocks, None), None, 0
        if self._samples is None:
            self.due_s = math.inf
            return
        # From the chunk before on, so that a chunk that begins earlier goes out at once.
        due = np.maximum.accumulate(np.maximum(self._samples.times, self.due_s))
        # Asked for one by one, numbers of Python are three times as fast as those of numpy.
        self._due = due.tolist()
        self.due_s = self._due[0]
