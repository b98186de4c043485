"""Makes inlets that wait for nothing without a limit and go on with no other outlet.

The first pull of an inlet that was never opened waits for its outlet as long as liblsl recovers
lost streams, for ever if the outlet is gone. And liblsl recovers by name, type and source_id
alone: it goes on with an outlet of another session or with another header. So liblsl never
recovers here. Whoever lost a stream looks for it again, by a resolver of the own session, and
reads its header again.
"""

from __future__ import annotations

from concurrent.futures import Executor, Future

import pylsl
import pylsl.util

LAST_ENTRY_S = 0.1
"""From a loss until the last entry of the queue is surely there, see `undelivered`."""
MOST_BUFFERED = 4_000_000
"""Samples. liblsl reserves 16 bytes for each at once, and programs may announce any rate."""


def buffer_length(rate: float, length: int, most: int = MOST_BUFFERED) -> int:
    """Return how much an inlet is to buffer.

    Parameters
    ----------
    rate
        Of the stream, in Hz.
    length
        In seconds, or hundreds of samples where the rate is 0, as liblsl has it.
    most
        Samples of a regular stream.
    """
    return length if rate * length <= most else max(1, int(most / rate))


def unopened_inlet(
    info: pylsl.StreamInfo, max_buflen: int = 1, *, as_numpy: bool = False
) -> pylsl.StreamInlet:
    """Return an inlet that asks for a header or a clock; to be opened with a limit before a pull.

    Raises
    ------
    RuntimeError
        If liblsl cannot make it.
    """
    return pylsl.StreamInlet(info, max_buflen=max_buflen, recover=False, as_numpy=as_numpy)


def open_inlet(
    info: pylsl.StreamInfo, limit_s: float, max_buflen: int = 1, *, as_numpy: bool = False
) -> pylsl.StreamInlet:
    """Return an inlet that gets what is sent from now on.

    Raises
    ------
    RuntimeError
        If liblsl cannot make it; ``TimeoutError`` or ``LostError`` of pylsl, if its outlet does
        not answer in time or is gone.
    """
    inlet = unopened_inlet(info, max_buflen, as_numpy=as_numpy)
    inlet.open_stream(limit_s)
    return inlet


def read_description(inlet: pylsl.StreamInlet, uid: str, limit_s: float) -> pylsl.StreamInfo:
    """Return what the outlet of an inlet says of its stream, with its description.

    An outlet that appears takes the port of one that has just ended, and answers whoever asks
    there, so that its header would be taken for that of the other stream.

    Raises
    ------
    RuntimeError
        ``TimeoutError`` or ``LostError`` of pylsl: it does not answer in time, or is gone.
    """
    info = inlet.info(limit_s)
    if info.uid() != uid:
        raise pylsl.util.LostError("another outlet has taken its port")
    return info


def undelivered(inlet: pylsl.StreamInlet) -> int:
    """Return how many samples liblsl drops of a lost stream, `LAST_ENTRY_S` after it was lost.

    The last entry of its queue is no sample: it wakes who waits. A thread of liblsl puts it there
    after it has called the stream lost, on a busy machine some time after, and nothing tells when.
    """
    return max(0, inlet.flush() - 1)


class Connection:
    """An inlet that is opened by a thread, and whose sender's clock other inlets measure.

    Parameters
    ----------
    info
        As a resolver gave it.
    pool
        Opens it; a sender that does not answer keeps the thread for `limit_s`.

    Attributes
    ----------
    is_ready
        Whether its sender's clock can be measured, see `biosensor_common.lsl.sender_clocks`.
    correction
        What was measured last, in seconds to add to stamps; None before the first time.
    """

    def __init__(
        self,
        info: pylsl.StreamInfo,
        pool: Executor,
        limit_s: float,
        max_buflen: int,
        *,
        as_numpy: bool = False,
    ) -> None:
        self.is_ready = True
        self.correction: float | None = None
        self._info = info
        self._opening: Future[pylsl.StreamInlet] = pool.submit(
            open_inlet, info, limit_s, max_buflen, as_numpy=as_numpy
        )

    @property
    def is_open(self) -> bool:
        """Whether it receives."""
        opening = self._opening
        return opening.done() and not opening.cancelled() and opening.exception() is None

    @property
    def inlet(self) -> pylsl.StreamInlet | None:
        """The inlet; None while it is being opened.

        Raises
        ------
        RuntimeError
            It could not be opened, see `open_inlet`.
        """
        return self._opening.result() if self._opening.done() else None

    def open_clock(self) -> pylsl.StreamInlet:
        """Open an inlet for one measurement of the sender's clock.

        Raises
        ------
        RuntimeError
            If liblsl can open none.
        """
        return unopened_inlet(self._info)

    def take_correction(self, correction: float) -> None:
        """Take in a measurement."""
        self.correction = correction

    def close(self) -> None:
        """Close it; one that is being opened closes by itself."""
        if not self._opening.cancel() and self.is_open:
            self._opening.result().close_stream()
