"""An LSL inlet that is opened in a separate thread and then read by reader threads."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from enum import Enum, unique
from time import monotonic

import pylsl
from pylsl import util

from biosensor_common.lsl.header import header_or_foreign, read_core
from biosensor_common.lsl.inlet import (
    LAST_ENTRY_S,
    buffer_length,
    read_description,
    undelivered,
    unopened_inlet,
)
from biosensor_common.lsl.network import matches_query, numbered
from biosensor_common.lsl.predicates import Predicate, all_of, has, none_of
from biosensor_common.quantities import ContentType
from biosensor_common.refusal import Refusal, Refusals
from biosensor_common.stream_header import (
    MAX_FIELD_CHARACTERS,
    CoreFields,
    StreamHeader,
)
from lsl_to_ros.lsl.delivery import Delivery, Reading, Receiver


def about(info: pylsl.StreamInfo) -> str:
    """Return a stream's name and computer, for sentences."""
    return f"LSL stream {info.name()[:MAX_FIELD_CHARACTERS]!r} of {info.hostname()}"


def header_of(info: pylsl.StreamInfo, core: CoreFields, refusals: Refusals) -> StreamHeader:
    """Return a stream's header, made from its core fields if the description is unreadable."""
    header, why = header_or_foreign(info.as_xml(), core)
    if why:
        refusals.refuse(Refusal.NO_DESCRIPTION, about=about(info), why=why)
    else:
        refusals.over(Refusal.NO_DESCRIPTION, about(info))
    return header


OPEN_TIMEOUT_S = 10.0
# Streams of ros_to_lsl are in ROS already; replays of their recordings are not.
FROM_ROS = all_of(has("desc/ros"), none_of(has("desc/replay")))
# How long the node may hang without losses: liblsl's default of 360 s takes 1.5 MB at 256 Hz, on
# both sides.
BUFFER_S = 120
# For irregular streams, which may burst at any rate, liblsl's default stays.
BUFFER_HUNDREDS = 360
CORRECTIONS_KEPT = 10


@unique
class InletState(Enum):
    """Life of an inlet.

    An inlet that ends is lost as soon as the samples that LSL dropped are counted. A lost or
    failed one is tried again; a refused one is not, because liblsl cannot read its announcement
    or does not support its protocol.
    """

    OPENING = "opening"
    READY = "ready"
    ENDING = "ending"
    LOST = "lost"
    FAILED = "failed"
    REFUSED = "refused"


_ENDED = InletState.ENDING, InletState.LOST, InletState.FAILED


class Inlet:
    """Opens a stream, reads its header, and delivers its samples to a receiver.

    Parameters
    ----------
    info
        Result of a resolver, without description.
    refusals
        Gets reports of an unusable stream or description, and of failed reads.
    number
        Number among streams with one identity, see `biosensor_common.lsl.network`.

    Raises
    ------
    SpecError
        ``INVALID``, if the stream has no channels, too many, or an impossible rate.
    """

    def __init__(self, info: pylsl.StreamInfo, refusals: Refusals, number: int = 1) -> None:
        self.number = number
        self.uid = info.uid()
        self.info = info  # As it was given.
        self.state = InletState.OPENING
        self.header: StreamHeader | None = None  # Set once the state is `READY`.
        self.core = read_core(info)
        # Whether this process publishes it; else only the node itself uses it.
        self.is_served = True
        self.is_from_ros = False  # Whether `ros_to_lsl` makes it from a topic.
        self._corrections = Corrections()
        self._delivery = Delivery()
        self._full_info: pylsl.StreamInfo | None = None
        self._refusals = refusals
        self._is_stopped = threading.Event()
        # Held by the reading thread, so that samples stay in order.
        self._pulling = threading.Lock()
        self._reading: Reading | None = None
        threading.Thread(target=self._open, daemon=True, name=f"open {info.name()}").start()

    @property
    def source_id(self) -> str:
        """The outlet's source_id, possibly empty."""
        return self.core.source_id

    @property
    def about(self) -> str:
        """The stream's name and computer, for sentences."""
        return about(self.info)

    @property
    def is_ready(self) -> bool:
        """Whether it can be read."""
        return self.state is InletState.READY

    @property
    def correction(self) -> float | None:
        """Seconds to add to a stamp for this machine's LSL clock; None while unknown."""
        return self._corrections.newest

    @property
    def correction_spread(self) -> float:
        """Largest minus smallest of the last ten clock corrections, in seconds."""
        return self._corrections.spread

    @property
    def heard_s(self) -> float:
        """Monotonic time of the latest samples, 0 before."""
        return self._delivery.heard_s

    @property
    def is_delivering(self) -> bool:
        """Whether it has a receiver."""
        return self._delivery.has_receiver

    @property
    def wants_each_sample(self) -> bool:
        """Whether its receiver wants samples at once."""
        return self._delivery.wants_each_sample

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

    def matches(self, predicate: Predicate) -> bool:
        """Whether the stream matches; True until its description is known."""
        info = self._full_info
        return info is None or matches_query(info, predicate)

    def deliver_to(self, receiver: Receiver) -> None:
        """Deliver buffered and future samples to this receiver.

        After the return the previous receiver gets no more samples.
        """
        self._delivery.begin(receiver, is_clock_known=self.correction is not None)

    def drain(self) -> None:
        """Deliver buffered samples without waiting, and detect whether the stream is lost.

        Nothing happens if another thread reads.
        """
        self._without_waiting(self._drain)

    def peek(self) -> None:
        """Deliver buffered samples as :meth:`drain`, but at almost no cost if there are none."""
        reading = self._reading
        if reading is not None and reading.waiting:
            self._without_waiting(self._drain)

    def follow(self, is_to_go_on: Callable[[], bool]) -> None:
        """Deliver each sample as it arrives, while *is_to_go_on* returns true."""
        with self._pulling:
            self._guarded(
                lambda reading: reading.follow(
                    lambda: not self._is_stopped.is_set() and is_to_go_on()
                )
            )

    @property
    def waiting(self) -> int:
        """Number of samples in the inlet's buffer."""
        reading = self._reading
        return 0 if reading is None or self.state is not InletState.READY else reading.waiting

    def give_up(self, since_s: float) -> bool:
        """End the delivery, unless samples were delivered after a monotonic time.

        Returns
        -------
        bool
            Whether it has ended: the receiver gets nothing more.
        """
        return self._delivery.end_unless_heard(since_s)

    def stop(self) -> threading.Thread:
        """End the inlet after the buffered samples; the receiver gets no more.

        Returns
        -------
        Thread
            Closes the inlet; it waits for the reader and for liblsl's threads.
        """
        self._without_waiting(lambda reading: reading.drain(lambda: not self._is_stopped.is_set()))
        self._is_stopped.set()
        self._delivery.end()
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
        return unopened_inlet(self.info)

    def take_correction(self, correction: float) -> None:
        """Store a measurement of the sender's clock."""
        if self._corrections.add(correction):
            self._delivery.clock_known()

    def _open(self) -> None:
        length = buffer_length(self.core.rate, BUFFER_S if self.core.rate else BUFFER_HUNDREDS)
        try:
            lsl = unopened_inlet(self.info, length, as_numpy=True)
        except RuntimeError as error:
            self._refusals.refuse(Refusal.UNUSABLE, about=self.about, why=f"LSL says: {error}")
            self.state = InletState.REFUSED
            return
        if not self._is_stopped.is_set():
            self._reading = Reading(lsl, self._delivery)
            self._guarded(self._read_descriptions)

    def _read_descriptions(self, reading: Reading) -> None:
        lsl = reading.lsl
        lsl.open_stream(OPEN_TIMEOUT_S)
        self._full_info = read_description(lsl, self.uid, OPEN_TIMEOUT_S)
        self.is_from_ros = matches_query(self._full_info, FROM_ROS)
        header = header_of(self._full_info, self.core, self._refusals)
        self.header = numbered(header, self.number)
        self.state = InletState.READY

    def _guarded(self, work: Callable[[Reading], None]) -> None:
        """Run *work* on liblsl's inlet; afterwards the state shows whether it failed."""
        reading = self._reading
        if reading is None or self.state in _ENDED:
            return  # nothing is dropped: there is no inlet
        try:
            work(reading)
        except (util.LostError, util.TimeoutError):
            # nothing is dropped: `end` is told what LSL dropped
            self.state = InletState.ENDING
            threading.Thread(
                target=self._count_undelivered, args=(reading.lsl,), daemon=True, name="count lost"
            ).start()
        except Exception as error:  # noqa: BLE001 - else the stream would end unsaid
            # nothing is dropped: `end` is told what LSL dropped
            if not self._is_stopped.is_set():
                self._refusals.refuse(Refusal.READ_FAILED, about=self.about, why=repr(error))
            self._delivery.end(reading.lsl.flush())
            self.state = InletState.FAILED

    def _count_undelivered(self, lsl: pylsl.StreamInlet) -> None:
        # In a thread, because other streams must not wait for it.
        time.sleep(LAST_ENTRY_S)
        self._delivery.end(undelivered(lsl))
        self.state = InletState.LOST

    def _without_waiting(self, work: Callable[[Reading], None]) -> None:
        if self._delivery.has_receiver and self._pulling.acquire(blocking=False):
            try:
                self._guarded(work)
            finally:
                self._pulling.release()

    def _drain(self, reading: Reading) -> None:
        reading.drain(self._is_to_be_read)

    def _is_to_be_read(self) -> bool:
        return not self._is_stopped.is_set() and self._delivery.has_room

    def _close(self) -> None:
        with self._pulling:
            self._reading = None


class Corrections:
    """The latest clock corrections of one sender."""

    def __init__(self) -> None:
        # Seconds to add to a stamp for this machine's LSL clock; None before the first measurement.
        self.newest: float | None = None
        # nothing is dropped: these are corrections
        self._recent: deque[float] = deque(maxlen=CORRECTIONS_KEPT)

    @property
    def spread(self) -> float:
        """Largest minus smallest of the last ten, in seconds."""
        # A copy, because another thread may add one meanwhile.
        recent = list(self._recent)
        return max(recent) - min(recent) if recent else 0.0

    def add(self, correction: float) -> bool:
        """Store a measurement; return whether it is the first."""
        is_first = self.newest is None
        self._recent.append(correction)
        self.newest = correction
        return is_first


DRAIN_PERIOD_S = 0.1
PEEK_PERIOD_S = 0.002
MOST_FOLLOWERS = 4


class Pump:
    """Keeps every inlet read."""

    def __init__(self, inlets: Callable[[], Iterable[Inlet]]) -> None:
        self._inlets = inlets
        self._is_crowded = False
        self._read: list[Inlet] = []
        self._followers: dict[str, threading.Thread] = {}
        self._peeker: threading.Thread | None = None
        self._stopping = threading.Event()
        self._drainer = threading.Thread(target=self._drain, daemon=True, name="drain")
        self._drainer.start()

    def look(self) -> None:
        """Update which inlets are read sample by sample; call it often."""
        self._read = [
            inlet
            for inlet in self._inlets()
            if inlet.state is InletState.READY and inlet.wants_each_sample
        ]
        self._is_crowded = len(self._read) > MOST_FOLLOWERS
        if not self._is_crowded:
            self._follow()
        elif self._peeker is None or not self._peeker.is_alive():
            self._peeker = threading.Thread(target=self._peek, daemon=True, name="peek")
            self._peeker.start()

    def stop(self) -> None:
        """End the shared threads; the others end with their inlets."""
        self._stopping.set()
        self._drainer.join()
        if self._peeker is not None:
            self._peeker.join()

    def _follow(self) -> None:
        for uid in [uid for uid, thread in self._followers.items() if not thread.is_alive()]:
            del self._followers[uid]
        for inlet in self._read:
            if inlet.uid not in self._followers:
                thread = threading.Thread(
                    target=inlet.follow,
                    args=(lambda inlet=inlet: inlet.wants_each_sample and not self._is_crowded,),
                    daemon=True,
                    name=f"follow {inlet.core.name}",
                )
                self._followers[inlet.uid] = thread
                thread.start()

    def _peek(self) -> None:
        while self._is_crowded and not self._stopping.is_set():
            for inlet in self._read:
                inlet.peek()
            time.sleep(PEEK_PERIOD_S)

    def _drain(self) -> None:
        while not self._stopping.wait(DRAIN_PERIOD_S):
            for inlet in self._inlets():
                if inlet.state is InletState.READY:
                    inlet.drain()


# Half a second longer than the period of the counters.
SILENT_AFTER_S = 1.5

Say = Callable[[str], None]


class Senders:
    """Watches the inlets of each computer that has an agent.

    Parameters
    ----------
    warn, inform
        Called with a sentence when a computer falls silent, and when it sends again.
    """

    def __init__(self, warn: Say, inform: Say) -> None:
        self._warn, self._inform = warn, inform
        self._silent: dict[str, float] = {}

    def look(self, inlets: Iterable[Inlet]) -> bool:
        """Update which computers are silent; return whether that has changed."""
        now, heard = monotonic(), _last_heard(inlets)
        silent = {host: at for host, at in heard.items() if now - at > SILENT_AFTER_S}
        fallen, returned = silent.keys() - self._silent.keys(), self._silent.keys() - silent.keys()
        for host in sorted(fallen):
            self._warn(f"{host}: {_sentence(now - silent[host])}")
        for host in sorted(returned & heard.keys()):
            self._inform(f"{host}: data arrives again, after {now - self._silent[host]:.1f} s")
        self._silent = silent
        return bool(fallen or returned)

    def trouble(self, host: str) -> str:
        """Return a sentence about a silent computer; empty if it is not silent."""
        heard_s = self._silent.get(host)
        return "" if heard_s is None else f"{host}: {_sentence(monotonic() - heard_s)}"


def _last_heard(inlets: Iterable[Inlet]) -> dict[str, float]:
    """Return when samples last came from each computer that has an agent."""
    heard: dict[str, float] = {}
    with_agent: set[str] = set()
    for inlet in inlets:
        if not inlet.heard_s:
            continue  # nothing is dropped: nothing came of it yet
        host = inlet.core.hostname
        heard[host] = max(heard.get(host, 0.0), inlet.heard_s)
        if inlet.core.content_type == ContentType.COUNTERS and not _is_foreign(inlet):
            with_agent.add(host)
    return {host: at for host, at in heard.items() if host in with_agent}


def _is_foreign(inlet: Inlet) -> bool:
    return inlet.header is None or inlet.header.foreign


def _sentence(seconds: float) -> str:
    return f"nothing received for {seconds:.1f} s; is its network interrupted?"
