"""One LSL inlet and the thread that reads it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from enum import Enum, unique
from typing import Any, Protocol

import pylsl

from biosensor_common.errors import SpecError
from biosensor_common.lsl_header import read_header
from biosensor_common.quantities import ChannelFormat
from biosensor_common.stream_header import CoreFields, StreamHeader, foreign_header

OPEN_TIMEOUT_S = 10.0
# How long a blocked pull keeps the thread from noticing that it should end.
PULL_TIMEOUT_S = 0.2
BATCH_TIMEOUT_S = 0.1
BATCH_SAMPLES = 1024
BUFFER_S = 360

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


class Receiver(Protocol):
    """Who gets an inlet's samples, in the inlet's thread."""

    @property
    def wants_each_sample(self) -> bool:
        """Whether samples are wanted at once rather than in batches."""
        ...

    def receive(self, sample: list[Any], stamp: float) -> None:
        """Take one sample with its stamp on the sender's LSL clock."""
        ...


class Inlet:
    """Opens a stream, reads its header, then hands every sample to a receiver.

    Parameters
    ----------
    info
        As a resolver gave it, without description.
    warn
        Called with a sentence when the stream's description is unusable.

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
        self._info = info
        self._warn = warn
        self._stop = threading.Event()
        self._receiver: Receiver | None = None
        self._has_receiver = threading.Event()
        # Recovery is ours: liblsl would reattach to a stream of another shape, or to none.
        self._inlet = pylsl.StreamInlet(info, max_buflen=BUFFER_S, recover=False)
        self._thread = threading.Thread(target=self._run, daemon=True, name=f"lsl {info.name()}")
        self._thread.start()

    def deliver_to(self, receiver: Receiver) -> None:
        """Start pulling, or go on for another receiver.

        What came since the stream was opened is delivered first.
        """
        self._receiver = receiver
        self._has_receiver.set()

    def stop(self) -> None:
        """Ask the thread to end."""
        self._stop.set()
        self._has_receiver.set()

    def join(self, timeout_s: float) -> None:
        """Wait for the thread's end."""
        self._thread.join(timeout_s)

    def measure_correction(self, timeout_s: float) -> None:
        """Refresh ``correction``; may block for seconds, so never call it in a reading thread."""
        # The reading thread finds a loss out and says so; the last correction still holds.
        with suppress(pylsl.LostError, pylsl.TimeoutError):
            self.correction = self._inlet.time_correction(timeout_s)

    def _run(self) -> None:
        try:
            self._inlet.open_stream(OPEN_TIMEOUT_S)
            self.header = self._read_header()
            self.state = InletState.READY
            self._has_receiver.wait()
            self._pull_until_stopped()
        except (pylsl.LostError, pylsl.TimeoutError):
            self.state = InletState.LOST

    def _read_header(self) -> StreamHeader:
        core = _core(self._info)
        try:
            return read_header(self._inlet.info(OPEN_TIMEOUT_S).as_xml())
        except SpecError as error:
            self._warn(f"{error}; the stream is published as an unknown one")
            return foreign_header(core)

    def _pull_until_stopped(self) -> None:
        inlet = self._inlet
        while not self._stop.is_set():
            receiver = self._receiver
            if receiver is None:
                return
            if receiver.wants_each_sample:
                sample, stamp = inlet.pull_sample(PULL_TIMEOUT_S)
                if sample is not None and stamp is not None:
                    receiver.receive(sample, stamp)
            else:
                samples, stamps = inlet.pull_chunk(BATCH_TIMEOUT_S, BATCH_SAMPLES)
                for sample, stamp in zip(samples, stamps, strict=True):
                    receiver.receive(sample, stamp)


def _core(info: pylsl.StreamInfo) -> CoreFields:
    return CoreFields(
        name=info.name(),
        content_type=info.type(),
        source_id=info.source_id(),
        hostname=info.hostname(),
        channel_count=info.channel_count(),
        rate=info.nominal_srate(),
        format=_FORMATS[info.channel_format()],
    )
