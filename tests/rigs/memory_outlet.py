"""An LSL outlet in memory, for unit tests that ask what was pushed and not who received it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pylsl
from numpy.typing import NDArray


class MemoryOutlet:
    """Takes what `LslOutlet` takes and keeps nothing; it always has consumers."""

    def __init__(self, info: pylsl.StreamInfo) -> None:
        self.channel_count = info.channel_count()
        self.is_text = info.channel_format() == pylsl.cf_string

    def push_sample(
        self, x: Sequence[Any] | NDArray[Any], timestamp: float = 0.0, pushthrough: bool = True
    ) -> None:
        """Take a sample of the right width."""
        assert len(x) == self.channel_count

    def push_chunk(
        self,
        x: Sequence[Any] | NDArray[Any],
        timestamp: float | Sequence[float] | NDArray[np.float64] = 0.0,
        pushthrough: bool = True,
    ) -> None:
        """Take samples of the right width, each with a stamp."""
        assert np.ndim(timestamp) == 0 or np.shape(timestamp) == (len(x),)
        assert np.shape(x) == (len(x), self.channel_count)

    def have_consumers(self) -> bool:
        """Whether somebody receives it: always, so that nothing waits."""
        return True
