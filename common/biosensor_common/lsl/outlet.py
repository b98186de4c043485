"""An LSL outlet that can be destroyed safely."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pylsl
from numpy.typing import NDArray

from biosensor_common.errors import TransportError, TransportReason
from biosensor_common.process_limits import OUTLET, require

REST_S = 0.02
"""Pause between the last push and the end of an outlet. liblsl's thread has begun to send by then;
liblsl 1.18 hangs or crashes if an outlet is destroyed at that very moment: see
docs/liblsl-closing-outlets.md."""


class LslOutlet(pylsl.StreamOutlet):
    """An outlet that, before it is destroyed, waits until the last sample is on its way.

    Raises
    ------
    TransportError
        ``EXHAUSTED``, if the system lets the process open no more files, or liblsl finds no port.
    """

    _pushed_s = -math.inf

    def __init__(self, info: pylsl.StreamInfo) -> None:
        require(OUTLET, f"the stream {info.name()}")
        try:
            super().__init__(info)
        except RuntimeError as error:
            message = (
                f"liblsl cannot open the stream {info.name()}: all of its ports are taken, or "
                "memory is short; doctor shows the ports"
            )
            raise TransportError(TransportReason.EXHAUSTED, message) from error

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
        """Record the time of a push that did not go through the methods above."""
        self._pushed_s = time.monotonic()

    def __del__(self) -> None:
        """Destroy the outlet, at the earliest `REST_S` after the last push."""
        time.sleep(max(0.0, self._pushed_s + REST_S - time.monotonic()))
        super().__del__()
