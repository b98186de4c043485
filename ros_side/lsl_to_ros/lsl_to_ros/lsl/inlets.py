"""One LSL inlet: opened in a thread of its own, then read by whoever asks."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from enum import Enum, unique
from typing import Protocol

import pylsl
from pylsl import util

from biosensor_common.announcements import read_core
from biosensor_common.errors import SpecError
from biosensor_common.lsl_header import read_header
from biosensor_common.quantities import ChannelFormat
from biosensor_common.stream_header import StreamHeader, foreign_header
from lsl_to_ros.lsl.blocks import Block, joined
from lsl_to_ros.lsl.buffering import buffer_length
from lsl_to_ros.lsl.liblsl import clock_inlet, matches_query, samples_available
from lsl_to_ros.lsl.pulls import decoded, pull, pull_one

OPEN_TIMEOUT_S = 10.0
CORRECTIONS_KEPT = 10
# How long a blocked pull keeps its thread from noticing that it should end.
PULL_TIMEOUT_S = 0.2
LAST_ENTRY_S = 0.1
# A receiver that is full is looked at again after so long.
ROOM_S = 0.01
BATCH_SAMPLES = 1024
# What ros_to_lsl sends is in ROS already; what is replayed from a recording of it is not.
FROM_ROS = "desc/ros and not(desc/replay)"


@unique
class InletState(Enum):
    """Life of an inlet.

    One that ends is lost as soon as it is counted what LSL dropped. A lost or failed one is
    tried again; a refused one is not, for liblsl cannot read its announcement or speak its
    protocol.
    """

    OPENING = "opening"
    READY = "ready"
    ENDING = "ending"
    LOST = "lost"
    FAILED = "failed"
    REFUSED = "refused"


class Receiver(Protocol):
    """Who gets an inlet's samples; its methods are never called at the same time."""

    @property
    def wants_each_sample(self) -> bool:
        """Whether samples are wanted at once rather than in batches."""
        ...

    @property
    def is_full(self) -> bool:
        """Whether it still has so much to do that samples should stay in LSL's buffer."""
        ...

    def receive(self, block: Block) -> None:
        """Take samples with their stamps on the sender's LSL clock."""
        ...

    def clock_known(self) -> None:
        """Take note that the sender's clock has been measured."""
        ...

    def end(self, undelivered: int) -> None:
        """Take note that no further sample comes, and how many LSL dropped at the end."""
        ...


class Inlet:
    """Opens a stream, reads its header, then hands its samples to a receiver.

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
        ``INVALID``, if the stream has no channels, too many, or an impossible rate.

    Attributes
    ----------
    info
        As it was given.
    header
        Set once the state is ``READY``.
    is_served
        Whether this process publishes it; else it only serves the node itself.
    is_from_ros
        Whether ``ros_to_lsl`` makes it of a topic.
    heard_s
        Monotonic time at which something came last, 0 before.
    correction
        Seconds to add to a stamp for this machine's LSL clock; None before the
        first measurement.
    """

    def __init__(self, info: pylsl.StreamInfo, warn: Callable[[str], None]) -> None:
        self.uid = info.uid()
        self.info = info
        self.state = InletState.OPENING
        self.header: StreamHeader | None = None
        self.core = read_core(info)
        self.correction: float | None = None
        self.is_served = True
        self.is_from_ros = False
        self.heard_s = 0.0
        self._corrections: deque[float] = deque(maxlen=CORRECTIONS_KEPT)
        self._full_info: pylsl.StreamInfo | None = None
        self._warn = warn
        self._is_stopped = threading.Event()
        # Held by whoever pulls, so that samples stay in order.
        self._pulling = threading.Lock()
        self._delivery = threading.Lock()
        self._receiver: Receiver | None = None
        self._lsl: pylsl.StreamInlet | None = None
        thread = threading.Thread(
            target=self._open, args=(info,), daemon=True, name=f"open {info.name()}"
        )
        thread.start()

    @property
    def source_id(self) -> str:
        """The outlet's, possibly empty."""
        return self.core.source_id

    @property
    def is_ready(self) -> bool:
        """Whether it can be read."""
        return self.state is InletState.READY

    @property
    def correction_spread(self) -> float:
        """Largest minus smallest of the last ten clock corrections, in seconds."""
        recent = list(self._corrections)
        return max(recent) - min(recent) if recent else 0.0

    @property
    def is_delivering(self) -> bool:
        """Whether it has a receiver."""
        return self._receiver is not None

    @property
    def wants_each_sample(self) -> bool:
        """Whether its receiver wants samples at once."""
        receiver = self._receiver
        return receiver is not None and receiver.wants_each_sample

    def continues_as(self, info: pylsl.StreamInfo) -> bool:
        """Whether *info* announces this stream, come back.

        Our source_ids are unique. Other programs give one to several streams, or
        copy it from an example, so that name and type must be the same too.
        """
        if not self.source_id or info.source_id() != self.source_id:
            return False
        is_ours = self.header is not None and not self.header.foreign
        core = self.core
        return is_ours or (info.name(), info.type()) == (core.name, core.content_type)

    def matches(self, query: str) -> bool:
        """Whether the stream fits an LSL query; an empty one fits all."""
        info = self._full_info
        return not query or info is None or matches_query(info, query)

    def deliver_to(self, receiver: Receiver) -> None:
        """Let a receiver have what comes from now on, and what waits in the inlet.

        After the return the previous receiver gets nothing more.
        """
        with self._delivery:
            if self._receiver is not None:
                self._receiver.end(0)
            self._receiver = receiver
            if self.correction is not None:
                receiver.clock_known()

    def drain(self) -> None:
        """Deliver what has come, without waiting, and find out whether the stream is lost.

        Nothing happens if another thread reads.
        """
        self._without_waiting(self._drain)

    def peek(self) -> None:
        """Deliver what has come, as :meth:`drain`, but at next to no cost if nothing has."""
        lsl = self._lsl
        if lsl is not None and samples_available(lsl):
            self._without_waiting(self._drain)

    def follow(self, is_to_go_on: Callable[[], bool]) -> None:
        """Deliver each sample as it comes, for as long as that is wanted."""
        with self._pulling:
            self._guarded(lambda lsl: self._follow(lsl, is_to_go_on))

    @property
    def has_samples(self) -> bool:
        """Whether samples have come that nobody has taken yet."""
        return self.waiting > 0

    @property
    def waiting(self) -> int:
        """Samples that have come and that nobody has taken yet."""
        lsl = self._lsl
        return 0 if lsl is None or self.state is not InletState.READY else samples_available(lsl)

    def give_up(self, since_s: float) -> bool:
        """End the delivery, unless something was delivered after that monotonic time.

        Returns
        -------
        bool
            Whether it has ended: the receiver gets nothing more.
        """
        with self._delivery:
            if self.heard_s > since_s:
                return False
            if self._receiver is not None:
                self._receiver.end(0)
            self._receiver = None
            return True

    def stop(self) -> threading.Thread:
        """End the inlet after what has come; the receiver gets nothing more.

        Returns
        -------
        Thread
            What closes it, which waits for a reader and for liblsl's own threads.
        """
        self._without_waiting(lambda lsl: self._drain(lsl, to_the_end=True))
        self._is_stopped.set()
        self._end_delivery(0)
        thread = threading.Thread(target=self._close, daemon=True, name="close an inlet")
        thread.start()
        return thread

    def open_clock(self) -> pylsl.StreamInlet:
        """Open an inlet for one measurement of the sender's clock.

        Raises
        ------
        RuntimeError
            If liblsl can open none.
        """
        return clock_inlet(self.info)

    def take_correction(self, correction: float) -> None:
        """Take in a measurement of the sender's clock."""
        is_first = self.correction is None
        self._corrections.append(correction)
        self.correction = correction
        if is_first:
            with self._delivery:
                if self._receiver is not None:
                    self._receiver.clock_known()

    def _open(self, info: pylsl.StreamInfo) -> None:
        try:
            # Recovery is ours: liblsl would reattach to a stream of another shape, or to none.
            lsl = pylsl.StreamInlet(
                info, max_buflen=buffer_length(self.core.rate), recover=False, as_numpy=True
            )
        except RuntimeError as error:
            self._warn(f"{self.core}: it is ignored, for LSL cannot open it ({error})")
            self.state = InletState.REFUSED
            return
        self._lsl = None if self._is_stopped.is_set() else lsl
        self._guarded(self._read_descriptions)

    def _read_descriptions(self, lsl: pylsl.StreamInlet) -> None:
        lsl.open_stream(OPEN_TIMEOUT_S)
        self._full_info = lsl.info(OPEN_TIMEOUT_S)
        self.is_from_ros = matches_query(self._full_info, FROM_ROS)
        self.header = self._read_header(self._full_info)
        self.state = InletState.READY

    def _read_header(self, info: pylsl.StreamInfo) -> StreamHeader:
        try:
            return read_header(info.as_xml())
        except SpecError as error:
            # What cannot be parsed does not say whose it is.
            said = str(error).removeprefix(f"{self.core}: ")
            self._warn(f"{self.core}: {said}; it is published as an unknown one")
            return foreign_header(self.core)

    def _guarded(self, work: Callable[[pylsl.StreamInlet], None]) -> None:
        """Do something with liblsl's inlet; the state says how it ended."""
        lsl = self._lsl
        if lsl is None or self.state in (InletState.ENDING, InletState.LOST, InletState.FAILED):
            return
        try:
            work(lsl)
        except (util.LostError, util.TimeoutError):
            self.state = InletState.ENDING
            count = threading.Thread(
                target=self._count_undelivered, args=(lsl,), daemon=True, name="count what is lost"
            )
            count.start()
        except Exception as error:  # noqa: BLE001 - else the stream would end unsaid
            if not self._is_stopped.is_set():
                self._warn(f"{self.core}: reading it failed, it is opened anew ({error!r})")
            self._end_delivery(lsl.flush())
            self.state = InletState.FAILED

    def _count_undelivered(self, lsl: pylsl.StreamInlet) -> None:
        # The last entry of a lost stream's queue is no sample: it wakes who waits. A thread of
        # liblsl puts it there after it has called the stream lost, on a busy machine some time
        # after. Nothing tells when it is there, and other streams must not wait for it.
        time.sleep(LAST_ENTRY_S)
        self._end_delivery(max(0, lsl.flush() - 1))
        self.state = InletState.LOST

    def _without_waiting(self, work: Callable[[pylsl.StreamInlet], None]) -> None:
        if self._receiver is not None and self._pulling.acquire(blocking=False):
            try:
                self._guarded(work)
            finally:
                self._pulling.release()

    @property
    def _has_room(self) -> bool:
        receiver = self._receiver
        return receiver is None or not receiver.is_full

    def _drain(self, lsl: pylsl.StreamInlet, *, to_the_end: bool = False) -> None:
        while not self._is_stopped.is_set() and (self._has_room or to_the_end):
            # At least one is asked for, because only a pull finds out about a loss.
            wanted = min(max(samples_available(lsl), 1), BATCH_SAMPLES)
            block = pull_one(lsl, 0.0) if wanted == 1 else pull(lsl, wanted)
            if block is not None:
                self._deliver(block)
            if wanted < BATCH_SAMPLES:
                return

    def _follow(self, lsl: pylsl.StreamInlet, is_to_go_on: Callable[[], bool]) -> None:
        while not self._is_stopped.is_set() and is_to_go_on():
            if not self._has_room:
                time.sleep(ROOM_S)
                continue
            block = pull_one(lsl, PULL_TIMEOUT_S)
            if block is None:
                continue
            waiting = min(samples_available(lsl), BATCH_SAMPLES)
            try:
                # What came in one packet belongs into one message where there is such.
                block = joined(block, pull(lsl, waiting)) if waiting else block
            finally:
                # The pull may find out that the stream is lost.
                self._deliver(block)

    def _deliver(self, block: Block) -> None:
        self.heard_s = time.monotonic()
        if self.core.format is ChannelFormat.STRING:
            block = Block(decoded(block.samples), block.stamps)
        # The receiver's publishers may be destroyed as soon as it is replaced.
        with self._delivery:
            if self._receiver is not None:
                self._receiver.receive(block)

    def _end_delivery(self, undelivered: int) -> None:
        with self._delivery:
            if self._receiver is not None:
                self._receiver.end(undelivered)
            self._receiver = None

    def _close(self) -> None:
        with self._pulling:
            self._lsl = None
