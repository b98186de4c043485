"""Makes inlets that wait for nothing without a limit, and takes samples out of them in blocks.

The first pull of an inlet that was never opened waits for its outlet as long as liblsl recovers
lost streams, for ever if the outlet is gone. And liblsl recovers by name, type and source_id
alone: it goes on with an outlet of another session or with another header. So liblsl never
recovers here. Whoever lost a stream looks for it again, by a resolver of the own session, and
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
"""From a loss until the last entry of the queue is surely there, see `undelivered`."""
MOST_BUFFERED = 4_000_000
"""Samples. liblsl reserves 16 bytes for each at once, and programs may announce any rate."""

Stamps = NDArray[np.float64]
"""LSL times in seconds, one a sample."""

# Calls through it keep the interpreter's lock. Giving it up takes longer than these
# calls do, and the next of many reading threads would take it.
_quick = ctypes.PyDLL(None, handle=lib._handle)  # noqa: SLF001 - the way that ctypes documents
_quick.lsl_local_clock.restype = ctypes.c_double
_quick.lsl_samples_available.restype = ctypes.c_uint32
_quick.lsl_samples_available.argtypes = (ctypes.c_void_p,)
# These give it up while they wait.
_waiting = ctypes.CDLL(None, handle=lib._handle)  # noqa: SLF001 - as above
# int64 is left to pylsl: which of C's types it is depends on the system.
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
        Shape [samples, channels], in the stream's own format; for text an array of
        objects that holds ``str``.
    stamps
        Times on the sender's LSL clock.
    """

    samples: NDArray[Any]
    stamps: Stamps


def local_clock() -> float:
    """Return this machine's LSL time in seconds."""
    return _quick.lsl_local_clock()


def samples_available(inlet: pylsl.StreamInlet) -> int:
    """Count the samples that an inlet holds; 0 also for one whose stream is lost."""
    return _quick.lsl_samples_available(inlet.obj)


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


def fetch_description(info: pylsl.StreamInfo, limit_s: float) -> str:
    """Return the full description of a stream, by a connection for a moment and without data.

    Raises
    ------
    RuntimeError
        As `read_description`.
    """
    return read_description(unopened_inlet(info), info.uid(), limit_s).as_xml()


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


class Puller:
    """Takes samples out of one inlet, which gives numpy arrays; for one thread at a time.

    Numbers are written where they are written each time, and copied from there: to make an array
    and ask for its address takes several times as long as liblsl takes for a few samples.

    Parameters
    ----------
    most
        Samples that are ever asked for at once.
    """

    def __init__(self, inlet: pylsl.StreamInlet, most: int) -> None:
        self._inlet, self._most = inlet, most
        self._is_text = inlet.np_dtype is None
        kind: np.dtype[Any] = np.dtype(object if self._is_text else inlet.np_dtype)
        self._numbers = _Numbers(inlet, kind, most) if kind in _PULLS else None

    @property
    def waiting(self) -> int:
        """Samples that have come and that nobody has taken yet."""
        return _quick.lsl_samples_available(self._inlet.obj)

    def pull(self, count: int) -> Block:
        """Take at most *count* samples of those that have come, without waiting; maybe none.

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
        """Take what has come, without waiting; maybe nothing.

        No more than there is is asked for: at the end of a lost stream liblsl throws away the
        rest. And at least one sample is, because only a pull finds out about a loss.

        Raises
        ------
        LostError
            The stream has ended.
        """
        return self.pull(min(max(1, self.waiting), self._most))

    def wait(self, limit_s: float) -> Block | None:
        """Wait for a sample, and take what has come with it; None if nothing comes in time.

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
            # Whether the stream is lost the next pull finds out, too.
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
    """The place of one inlet to which liblsl writes its samples."""

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
        """Write the next sample to the first place; return whether there is one."""
        stamp = self._wait(self._inlet, self._samples_at, self._channels, limit_s, self._error_at)
        if self._error.value:
            pylsl.util.handle_error(self._error)
        self._stamps[0] = stamp
        return 1 if stamp else 0

    def take(self, place: int, count: int, *, may_be_lost: bool = False) -> int:
        """Write at most *count* samples that have come, from a place on; return how many."""
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
        """Return a copy of what is written at the first places."""
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
