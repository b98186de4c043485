"""Makes inlets that never wait without a time limit, and pulls blocks of samples from them.

The first pull of an inlet that was never opened waits for its outlet as long as liblsl recovers
lost streams: forever, if the outlet is gone. And liblsl recovers by name, type and source_id
alone, so it may continue with an outlet of another session or with another header. Recovery is
therefore switched off: a receiver that lost a stream resolves it again in its own session, and
reads its header again.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any, NamedTuple

import numpy as np
import pylsl
import pylsl.util
from numpy.typing import NDArray
from pylsl.lib import lib

from biosensor_common.lsl.header import decoded

LAST_ENTRY_S = 0.1
"""After this time a lost stream's queue has its last entry, see `undelivered`."""
MOST_BUFFERED = 4_000_000
"""Samples. liblsl reserves 16 bytes for each at once, and programs may announce any rate."""

Stamps = NDArray[np.float64]
"""LSL times in seconds, one per sample."""

# Calls through PyDLL keep the GIL. Releasing it takes longer than these calls themselves,
# and another of many reading threads would then take it. The name loads nothing where there is a
# handle, but on Windows ctypes fails without one.
_quick = ctypes.PyDLL(lib._name, handle=lib._handle)  # noqa: SLF001 - the way that ctypes documents
_quick.lsl_local_clock.restype = ctypes.c_double
_quick.lsl_samples_available.restype = ctypes.c_uint32
_quick.lsl_samples_available.argtypes = (ctypes.c_void_p,)
# These calls wait, so they release the GIL.
_waiting = ctypes.CDLL(lib._name, handle=lib._handle)  # noqa: SLF001 - as above
# int64 is left to pylsl: its C type depends on the system.
_LETTERS = {"f4": "f", "f8": "d", "i4": "i", "i2": "s", "i1": "c"}
_PULLS: dict[np.dtype[Any], tuple[Callable[..., int], Callable[..., float]]] = {}
for _kind, _letter in _LETTERS.items():
    _chunk = getattr(_quick, f"lsl_pull_chunk_{_letter}")
    _chunk.restype = ctypes.c_ulong
    _chunk.argtypes = (
        *(ctypes.c_void_p,) * 3,
        *(ctypes.c_ulong,) * 2,
        ctypes.c_double,
        ctypes.c_void_p,
    )
    _sample = getattr(_waiting, f"lsl_pull_sample_{_letter}")
    _sample.restype = ctypes.c_double
    _sample.argtypes = (
        *(ctypes.c_void_p,) * 2,
        ctypes.c_int,
        ctypes.c_double,
        ctypes.c_void_p,
    )
    _PULLS[np.dtype(_kind)] = _chunk, _sample


class Block(NamedTuple):
    """Samples that were pulled together.

    Attributes
    ----------
    samples
        Shape [samples, channels], in the stream's own format; text is an object array of
        ``str``.
    stamps
        Times on the sender's LSL clock.
    """

    samples: NDArray[Any]
    stamps: Stamps


def local_clock() -> float:
    """Return this machine's LSL time in seconds."""
    return _quick.lsl_local_clock()


def samples_available(inlet: pylsl.StreamInlet) -> int:
    """Return the number of samples in an inlet's buffer; 0 also if its stream is lost."""
    return _quick.lsl_samples_available(inlet.obj)


def buffer_length(rate: float, length: int, most: int = MOST_BUFFERED) -> int:
    """Return the ``max_buflen`` of an inlet.

    Parameters
    ----------
    rate
        Of the stream, in Hz.
    length
        In seconds, or in hundreds of samples where the rate is 0, as in liblsl.
    most
        Largest number of samples of a regular stream.
    """
    return length if rate * length <= most else max(1, int(most / rate))


def unopened_inlet(
    info: pylsl.StreamInfo, max_buflen: int = 1, *, as_numpy: bool = False
) -> pylsl.StreamInlet:
    """Return an inlet for a header or a clock; open it with a time limit before a pull.

    Raises
    ------
    RuntimeError
        If liblsl cannot make it.
    """
    return pylsl.StreamInlet(info, max_buflen=max_buflen, recover=False, as_numpy=as_numpy)


def open_inlet(
    info: pylsl.StreamInfo, limit_s: float, max_buflen: int = 1, *, as_numpy: bool = False
) -> pylsl.StreamInlet:
    """Return an inlet that receives all samples sent from now on.

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
    """Return the full header of an inlet's stream, with its description.

    A new outlet may take the port of one that has just ended, and would answer with its own
    header. So the uid of the answer is checked.

    Raises
    ------
    RuntimeError
        ``TimeoutError`` or ``LostError`` of pylsl: it does not answer in time, or is gone.
    """
    info = inlet.info(limit_s)
    if info.uid() != uid:
        raise pylsl.util.LostError("another outlet has taken its port")
    return info


def fetch_description(info: pylsl.StreamInfo, limit_s: float) -> str:
    """Return the full description of a stream, through a short connection without data.

    Raises
    ------
    RuntimeError
        As `read_description`.
    """
    return read_description(unopened_inlet(info), info.uid(), limit_s).as_xml()


def undelivered(inlet: pylsl.StreamInlet) -> int:
    """Return how many samples of a lost stream liblsl drops, `LAST_ENTRY_S` after the loss.

    The last entry of the queue is not a sample: it wakes the reader. A thread of liblsl adds it
    after it has marked the stream as lost, on a busy machine some time later.
    """
    return max(0, inlet.flush() - 1)


class Connection:
    """An inlet that a thread opens; its sender's clock is measured by other inlets.

    Parameters
    ----------
    info
        Result of a resolver.
    pool
        Opens the inlet; a sender that does not answer blocks the thread for `limit_s`.

    Attributes
    ----------
    is_ready
        Whether its sender's clock can be measured, see `biosensor_common.lsl.sender_clocks`.
    correction
        Latest clock correction, in seconds to add to stamps; None before the first measurement.
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
        """Whether the inlet is open."""
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
        """Store a measured clock correction."""
        self.correction = correction

    def close(self) -> None:
        """Close the inlet; one that is being opened closes as soon as it is open."""
        if not self._opening.cancel() and self.is_open:
            self._opening.result().close_stream()


class Puller:
    """Pulls samples from one inlet as numpy arrays; for one thread at a time.

    liblsl always writes numbers to the same array, from which they are copied: making an array and
    taking its address costs several times as much as pulling a few samples.

    Parameters
    ----------
    most
        Largest number of samples in one pull.
    """

    def __init__(self, inlet: pylsl.StreamInlet, most: int) -> None:
        self._inlet, self._most = inlet, most
        self._is_text = inlet.np_dtype is None
        kind: np.dtype[Any] = np.dtype(object if self._is_text else inlet.np_dtype)
        self._numbers = _Numbers(inlet, kind, most) if kind in _PULLS else None

    @property
    def waiting(self) -> int:
        """Number of samples in the inlet's buffer."""
        return _quick.lsl_samples_available(self._inlet.obj)

    def pull(self, count: int) -> Block:
        """Pull at most *count* buffered samples, without waiting; possibly none.

        Raises
        ------
        LostError
            The stream has ended.
        """
        if self._numbers is not None:
            return self._numbers.block(self._numbers.take(0, count))
        samples, stamps = self._inlet.pull_chunk(0.0, count)
        return Block(_decoded(samples) if self._is_text else samples, stamps)

    def pull_waiting(self) -> Block:
        """Pull all buffered samples, without waiting; possibly none.

        Never asks for more than is buffered, because liblsl then discards the rest of a lost
        stream. Always asks for at least one sample, because only a pull detects a loss.

        Raises
        ------
        LostError
            The stream has ended.
        """
        return self.pull(min(max(1, self.waiting), self._most))

    def wait(self, limit_s: float) -> Block | None:
        """Wait for a sample and pull all that came with it; None after the time limit.

        Raises
        ------
        LostError
            The stream has ended.
        """
        if self._numbers is not None:
            taken = self._numbers.wait(limit_s)
            if not taken:
                return None  # nothing is dropped: nothing has come
            more = min(self.waiting, self._most - taken)
            # The next pull detects a lost stream, too.
            taken += self._numbers.take(taken, more, may_be_lost=True) if more else 0
            return self._numbers.block(taken)
        sample, stamp = self._inlet.pull_sample(limit_s)
        if sample is None:
            return None  # nothing is dropped: nothing has come
        samples = sample[np.newaxis]
        first = Block(_decoded(samples) if self._is_text else samples, np.array([stamp]))
        more = min(self.waiting, self._most - 1)
        return _joined(first, self._pull_if_there(more)) if more else first

    def _pull_if_there(self, count: int) -> Block | None:
        try:
            return self.pull(count)
        except pylsl.util.LostError:
            # nothing is dropped: the next pull finds out, too
            return None


class _Numbers:
    """The arrays to which liblsl writes one inlet's samples."""

    def __init__(self, inlet: pylsl.StreamInlet, kind: np.dtype[Any], most: int) -> None:
        self._samples: NDArray[Any] = np.empty((most, inlet.channel_count), kind)
        self._stamps: Stamps = np.empty(most)
        self._error = ctypes.c_int()
        self._channels = inlet.channel_count
        self._pull, self._wait = _PULLS[kind]
        self._inlet = inlet.obj
        self._samples_at, self._stamps_at = self._samples.ctypes.data, self._stamps.ctypes.data
        self._sample_size = self._samples.strides[0]
        self._error_at = ctypes.addressof(self._error)

    def wait(self, limit_s: float) -> int:
        """Wait for the next sample, write it to the first row, and return whether there was one."""
        stamp = self._wait(self._inlet, self._samples_at, self._channels, limit_s, self._error_at)
        if self._error.value:
            pylsl.util.handle_error(self._error)
        self._stamps[0] = stamp
        return 1 if stamp else 0

    def take(self, place: int, count: int, *, may_be_lost: bool = False) -> int:
        """Write at most *count* buffered samples, starting at a row; return how many."""
        values = self._pull(
            self._inlet,
            self._samples_at + place * self._sample_size,
            self._stamps_at + place * self._stamps.itemsize,
            count * self._channels,
            count,
            0.0,
            self._error_at,
        )
        if self._error.value:
            if may_be_lost:
                return 0
            pylsl.util.handle_error(self._error)
        return values // self._channels

    def block(self, count: int) -> Block:
        """Return a copy of the first rows."""
        return Block(self._samples[:count].copy(), self._stamps[:count].copy())


def _joined(first: Block, second: Block | None) -> Block:
    if second is None or not len(second.stamps):
        return first
    return Block(
        np.concatenate((first.samples, second.samples)),
        np.concatenate((first.stamps, second.stamps)),
    )


def _decoded(samples: NDArray[Any]) -> NDArray[Any]:
    texts = np.empty_like(samples)
    for place, text in np.ndenumerate(samples):
        texts[place] = decoded(text)
    return texts
