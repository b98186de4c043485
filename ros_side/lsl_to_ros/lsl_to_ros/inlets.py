"""One LSL inlet and the thread that reads it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from enum import Enum, unique
from typing import Any, Protocol

import pylsl
from pylsl import util

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.lsl_header import read_header
from biosensor_common.quantities import ChannelFormat
from biosensor_common.stream_header import CoreFields, StreamHeader, foreign_header

OPEN_TIMEOUT_S = 10.0
# How long a blocked pull keeps the thread from noticing that it should end.
PULL_TIMEOUT_S = 0.2
BATCH_TIMEOUT_S = 0.1
BATCH_SAMPLES = 1024
BUFFER_S = 360
# What other programs announce may be anything, and liblsl would reserve memory for it.
BUFFER_SAMPLES = 4_000_000
MAX_RATE_HZ = 1e6

_FORMATS = {
    pylsl.cf_float32: ChannelFormat.FLOAT32,
    pylsl.cf_double64: ChannelFormat.DOUBLE64,
    pylsl.cf_string: ChannelFormat.STRING,
    pylsl.cf_int32: ChannelFormat.INT32,
    pylsl.cf_int16: ChannelFormat.INT16,
    pylsl.cf_int8: ChannelFormat.INT8,
    pylsl.cf_int64: ChannelFormat.INT64,
}


@unique
class InletState(Enum):
    """Life of an inlet."""

    OPENING = "opening"
    READY = "ready"
    LOST = "lost"
    FAILED = "failed"


class Receiver(Protocol):
    """Who gets an inlet's samples, in the inlet's thread."""

    @property
    def wants_each_sample(self) -> bool:
        """Whether samples are wanted at once rather than in batches."""
        ...

    def receive(self, sample: list[Any], stamp: float) -> None:
        """Take one sample with its stamp on the sender's LSL clock."""
        ...

    def end(self) -> None:
        """Take note that no further sample comes; never called during :meth:`receive`."""
        ...


class Inlet:
    """Opens a stream, reads its header, then hands every sample to a receiver.

    Parameters
    ----------
    info
        As a resolver gave it, without description.
    warn
        Called with a sentence when the stream's description is unusable, and when
        reading it failed.

    Raises
    ------
    SpecError
        ``INVALID``, if the stream has no channels or an impossible rate.
    RuntimeError
        If liblsl cannot read the announcement or speak its protocol.

    Attributes
    ----------
    header
        Set once the state is ``READY``.
    correction
        Seconds to add to a stamp for this machine's LSL clock; None before the
        first measurement.
    """

    def __init__(self, info: pylsl.StreamInfo, warn: Callable[[str], None]) -> None:
        self.uid = info.uid()
        self.source_id = info.source_id()
        self.state = InletState.OPENING
        self.header: StreamHeader | None = None
        self.correction: float | None = None
        self._core = _core(info)
        self._warn = warn
        self._stop = threading.Event()
        self._delivery = threading.Lock()
        self._receiver: Receiver | None = None
        self._has_receiver = threading.Event()
        # Recovery is ours: liblsl would reattach to a stream of another shape, or to none.
        self._inlet = pylsl.StreamInlet(
            info,
            max_buflen=_buffer_length(self._core.rate),
            recover=False,
            as_numpy=self._is_text,
        )
        self._thread = threading.Thread(target=self._run, daemon=True, name=f"lsl {info.name()}")
        self._thread.start()

    def continues_as(self, info: pylsl.StreamInfo) -> bool:
        """Whether *info* announces this stream, come back.

        Our source_ids are unique. Other programs give one to several streams, or
        copy it from an example, so that name and type must be the same too.
        """
        if not self.source_id or info.source_id() != self.source_id:
            return False
        is_ours = self.header is not None and not self.header.foreign
        core = self._core
        return is_ours or (info.name(), info.type()) == (core.name, core.content_type)

    def deliver_to(self, receiver: Receiver) -> None:
        """Start pulling, or go on for another receiver.

        What came since the stream was opened is delivered first. After the return
        the previous receiver gets nothing more.
        """
        self._hand_over(receiver)
        self._has_receiver.set()

    def stop(self) -> None:
        """Ask the thread to end; the receiver gets nothing more."""
        self._stop.set()
        self._hand_over(None)
        self._has_receiver.set()

    def join(self, timeout_s: float) -> None:
        """Wait for the thread's end."""
        self._thread.join(timeout_s)

    def measure_correction(self, timeout_s: float) -> None:
        """Refresh ``correction``; may block for seconds, so never call it in a reading thread."""
        # The reading thread finds a loss out and says so; the last correction still holds.
        # Every error of pylsl is a RuntimeError.
        with suppress(RuntimeError):
            self.correction = self._inlet.time_correction(timeout_s)

    def _run(self) -> None:
        try:
            self._inlet.open_stream(OPEN_TIMEOUT_S)
            self.header = self._read_header()
            self.state = InletState.READY
            self._has_receiver.wait()
            self._pull_until_stopped()
        except (util.LostError, util.TimeoutError):
            self.state = InletState.LOST
        except Exception as error:  # noqa: BLE001 - else the stream would end unsaid
            self._warn(f"{self._core}: reading it failed, it is opened anew ({error!r})")
            self.state = InletState.FAILED

    def _read_header(self) -> StreamHeader:
        try:
            return read_header(self._inlet.info(OPEN_TIMEOUT_S).as_xml())
        except SpecError as error:
            # What cannot be parsed does not say whose it is.
            said = str(error).removeprefix(f"{self._core}: ")
            self._warn(f"{self._core}: {said}; it is published as an unknown one")
            return foreign_header(self._core)

    @property
    def _is_text(self) -> bool:
        return self._core.format is ChannelFormat.STRING

    def _pull_until_stopped(self) -> None:
        inlet = self._inlet
        while not self._stop.is_set():
            if self._wants_each_sample():
                sample, stamp = inlet.pull_sample(PULL_TIMEOUT_S)
                if sample is not None and stamp is not None:
                    self._deliver(sample, stamp)
            else:
                samples, stamps = inlet.pull_chunk(BATCH_TIMEOUT_S, BATCH_SAMPLES)
                for sample, stamp in zip(samples, stamps, strict=True):
                    self._deliver(sample, stamp)

    def _wants_each_sample(self) -> bool:
        with self._delivery:
            return self._receiver is not None and self._receiver.wants_each_sample

    def _deliver(self, sample: Sequence[Any], stamp: float) -> None:
        values = [_decode(text) for text in sample] if self._is_text else list(sample)
        # The receiver's publishers may be destroyed as soon as it is replaced.
        with self._delivery:
            if self._receiver is not None:
                self._receiver.receive(values, stamp)

    def _hand_over(self, receiver: Receiver | None) -> None:
        with self._delivery:
            if self._receiver is not None:
                self._receiver.end()
            self._receiver = receiver


def _decode(text: bytes) -> str:
    """Decode text as pylsl does names: UTF-8, else what a Windows program means by it."""
    try:
        return text.decode()
    except UnicodeDecodeError:
        return text.decode("latin-1")


def _core(info: pylsl.StreamInfo) -> CoreFields:
    if info.channel_count() < 1:
        raise SpecError(SpecReason.INVALID, f"LSL stream {info.name()!r} has no channels")
    if not 0 <= info.nominal_srate() <= MAX_RATE_HZ:
        message = f"LSL stream {info.name()!r}: {info.nominal_srate()} Hz is no possible rate"
        raise SpecError(SpecReason.INVALID, message)
    return CoreFields(
        name=info.name(),
        content_type=info.type(),
        source_id=info.source_id(),
        hostname=info.hostname(),
        channel_count=info.channel_count(),
        rate=info.nominal_srate(),
        format=_FORMATS[info.channel_format()],
    )


def _buffer_length(rate: float) -> int:
    """Seconds to buffer; hundreds of samples where the rate is 0, as liblsl has it."""
    return BUFFER_S if rate * BUFFER_S <= BUFFER_SAMPLES else max(1, int(BUFFER_SAMPLES / rate))
