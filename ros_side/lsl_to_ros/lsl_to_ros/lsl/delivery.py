"""Takes samples out of an inlet, and hands them to whoever wants them at that time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Protocol

import pylsl

from biosensor_common.lsl.inlet import Block, Puller

# How long a blocked pull keeps its thread from noticing that it should end.
PULL_TIMEOUT_S = 0.2
# A receiver that is full is looked at again after so long.
ROOM_S = 0.01
BATCH_SAMPLES = 1024

Condition = Callable[[], bool]


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


class Delivery:
    """Delivers blocks to one receiver at a time.

    Attributes
    ----------
    heard_s
        Monotonic time at which something came last, 0 before.
    """

    def __init__(self) -> None:
        self.heard_s = 0.0
        self._receiver: Receiver | None = None
        # Held while the receiver is called: its publishers may be destroyed as soon as it is
        # replaced.
        self._lock = threading.Lock()

    @property
    def has_receiver(self) -> bool:
        """Whether anybody gets what comes."""
        return self._receiver is not None

    @property
    def wants_each_sample(self) -> bool:
        """Whether the receiver wants samples at once."""
        receiver = self._receiver
        return receiver is not None and receiver.wants_each_sample

    @property
    def has_room(self) -> bool:
        """Whether the receiver should get more; without one, nothing keeps it from being read."""
        receiver = self._receiver
        return receiver is None or not receiver.is_full

    def begin(self, receiver: Receiver, *, is_clock_known: bool) -> None:
        """Deliver to this receiver from now on; the previous one gets nothing more."""
        with self._lock:
            if self._receiver is not None:
                self._receiver.end(0)
            self._receiver = receiver
            if is_clock_known:
                receiver.clock_known()

    def deliver(self, block: Block) -> None:
        """Deliver samples, if there is a receiver."""
        self.heard_s = time.monotonic()
        with self._lock:
            if self._receiver is not None:
                self._receiver.receive(block)

    def clock_known(self) -> None:
        """Tell the receiver that the sender's clock has been measured."""
        with self._lock:
            if self._receiver is not None:
                self._receiver.clock_known()

    def end(self, undelivered: int = 0) -> None:
        """Tell the receiver that nothing more comes, and how many samples LSL dropped."""
        with self._lock:
            self._end(undelivered)

    def end_unless_heard(self, since_s: float) -> bool:
        """End, unless something was delivered after that monotonic time; return whether it has."""
        with self._lock:
            if self.heard_s > since_s:
                return False
            self._end(0)
            return True

    def _end(self, undelivered: int) -> None:
        if self._receiver is not None:
            self._receiver.end(undelivered)
        self._receiver = None


class Reading:
    """Takes samples out of an inlet and delivers them; one thread at a time may call it.

    Parameters
    ----------
    lsl
        The inlet, which gives numpy arrays.

    Attributes
    ----------
    lsl
        As it was given.
    """

    def __init__(self, lsl: pylsl.StreamInlet, delivery: Delivery) -> None:
        self.lsl = lsl
        self._delivery = delivery
        self._puller = Puller(lsl, BATCH_SAMPLES)

    @property
    def waiting(self) -> int:
        """Samples that have come and that nobody has taken yet."""
        return self._puller.waiting

    def drain(self, is_to_go_on: Condition) -> None:
        """Deliver what has come, without waiting, for as long as that is wanted.

        Raises
        ------
        LostError
            The stream has ended.
        """
        while is_to_go_on():
            block = self._puller.pull_waiting()
            count = len(block.stamps)
            if count:
                self._delivery.deliver(block)
            if count < BATCH_SAMPLES:
                return  # nothing is dropped: all that had come is delivered

    def follow(self, is_to_go_on: Condition) -> None:
        """Deliver each sample as it comes, for as long as that is wanted.

        What came in one packet belongs into one message where there is such.

        Raises
        ------
        LostError
            The stream has ended.
        """
        while is_to_go_on():
            if not self._delivery.has_room:
                time.sleep(ROOM_S)
                continue  # nothing is dropped: they wait in liblsl
            block = self._puller.wait(PULL_TIMEOUT_S)
            if block is not None:
                self._delivery.deliver(block)
