"""An LSL outlet whose end is safe."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pylsl
from numpy.typing import NDArray

from biosensor_common.process_limits import OUTLET, require

REST_S = 0.02
"""From the last push to the end of an outlet. LSL's own thread has begun to send by then; liblsl
1.18 hangs for ever, or crashes, if an outlet ends at that very moment: see
docs/liblsl-closing-outlets.md."""


class LslOutlet(pylsl.StreamOutlet):
    """An outlet that, to be destroyed, waits until what was pushed last is on its way.

    Raises
    ------
    TransportError
        ``EXHAUSTED``, if the system lets the process open no more files.
    """

    _pushed_s = -math.inf

    def __init__(self, info: pylsl.StreamInfo) -> None:
        require(OUTLET, f"the stream {info.name()}")
        super().__init__(info)

    def push_sample(
        self, x: Sequence[Any] | NDArray[Any], timestamp: float = 0.0, pushthrough: bool = True
    ) -> None:
        """See pylsl."""
        super().push_sample(x, timestamp, pushthrough)
        self.note_push()

    def push_chunk(
        self,
        x: Sequence[Any] | NDArray[Any],
        timestamp: float | Sequence[float] | NDArray[np.float64] = 0.0,
        pushthrough: bool = True,
    ) -> None:
        """See pylsl."""
        super().push_chunk(x, timestamp, pushthrough)
        self.note_push()

    def note_push(self) -> None:
        """Note that something was pushed by another function than those above."""
        self._pushed_s = time.monotonic()

    def __del__(self) -> None:
        """Destroy it, `REST_S` after the last push at the earliest."""
        time.sleep(max(0.0, self._pushed_s + REST_S - time.monotonic()))
        super().__del__()
