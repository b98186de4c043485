"""One open inlet: takes out of liblsl what has come."""

from __future__ import annotations

from concurrent.futures import Executor
from time import monotonic
from typing import Any, NamedTuple

import numpy as np
import pylsl
from numpy.typing import NDArray

from biosensor_common.lsl.inlet import Connection, buffer_length
from biosensor_common.quantities import ChannelFormat
from biosensor_common.stream_header import CoreFields

CLOCK_WITHIN_S = 3.0
"""So long samples wait in liblsl for the first measurement of the sender's clock."""
_OPEN_S = 5.0
_BUFFER_S, _BUFFER_SAMPLES = 10, 200_000
_MOST_SAMPLES, _MOST_VALUES = 8192, 1_000_000
_MOST_TEXTS = 16


class Block(NamedTuple):
    """Samples that were pulled together.

    Attributes
    ----------
    samples : shape (n, n_channels)
        In the stream's own format; of text, bytes.
    stamps : shape (n,)
        On the sender's LSL clock.
    """

    samples: NDArray[Any]
    stamps: NDArray[np.float64]


class Receiver:
    """Receives one stream, for as long as somebody looks at it.

    Parameters
    ----------
    info
        As a resolver gave it.
    core
        What that says.
    pool
        Opens it; a sender that does not answer keeps the thread for some seconds.
    """

    def __init__(self, info: pylsl.StreamInfo, core: CoreFields, pool: Executor) -> None:
        self._is_text = core.format is ChannelFormat.STRING
        self._most = max(1, min(_MOST_SAMPLES, _MOST_VALUES // core.channel_count))
        self._opened_s = monotonic()
        length = buffer_length(core.rate, _BUFFER_S, _BUFFER_SAMPLES)
        self.connection = Connection(info, pool, _OPEN_S, length, as_numpy=True)

    @property
    def age_s(self) -> float:
        """How long it has been open."""
        return monotonic() - self._opened_s

    @property
    def correction(self) -> float | None:
        """Seconds to add to stamps; None before the sender's clock was measured."""
        return self.connection.correction

    def pull(self) -> Block | None:
        """Return what has come, without waiting; None if nothing has.

        Raises
        ------
        RuntimeError
            The stream is lost, or was not opened.
        """
        lsl = self.connection.inlet
        if lsl is None:
            return None  # nothing is dropped: it is being opened
        if self.correction is None and self.age_s < CLOCK_WITHIN_S:
            return None  # nothing is dropped: they wait in liblsl
        # Only a pull finds out about a loss, so at least one sample is asked for.
        most = _MOST_TEXTS if self._is_text else min(max(1, lsl.samples_available()), self._most)
        samples, stamps = lsl.pull_chunk(0.0, most)
        return Block(samples, stamps) if len(stamps) else None

    def close(self) -> None:
        """End it; waits for liblsl's own threads."""
        self.connection.close()
