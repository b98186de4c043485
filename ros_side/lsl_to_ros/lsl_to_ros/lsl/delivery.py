"""Pulls samples from an inlet and delivers them to its present receiver."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Protocol

import pylsl

from biosensor_common.lsl.inlet import Block, Puller

# Longest blocking pull, after which the thread checks whether it should end.
PULL_TIMEOUT_S = 0.2
# Pause until a receiver that was full is checked again.
ROOM_S = 0.01
BATCH_SAMPLES = 1024

Condition = Callable[[], bool]


class Receiver(Protocol):
    """Receives an inlet's samples; its methods are never called concurrently."""

    @property
    def wants_each_sample(self) -> bool:
        """Whether samples are wanted at once rather than in batches."""
        ...

    @property
    def is_full(self) -> bool:
        """Whether it has such a backlog that samples should stay in LSL's buffer."""
        ...

    def receive(self, block: Block) -> None:
        """Process samples with their stamps on the sender's LSL clock."""
        ...

    def clock_known(self) -> None:
        """Handle that the sender's clock has been measured."""
        ...

    def end(self, undelivered: int) -> None:
        """Handle the end of the stream; LSL dropped *undelivered* samples."""
        ...


class Delivery:
    """Delivers blocks to one receiver at a time."""

    def __init__(self) -> None:
        self.heard_s = 0.0  # Monotonic time of the latest samples, 0 before.
        self._receiver: Receiver | None = None
        # Held while the receiver is called, because its publishers may be destroyed as soon as
        # it is replaced.
        self._lock = threading.Lock()

    @property
    def has_receiver(self) -> bool:
        """Whether there is a receiver."""
        return self._receiver is not None

    @property
    def wants_each_sample(self) -> bool:
        """Whether the receiver wants samples at once."""
        receiver = self._receiver
        return receiver is not None and receiver.wants_each_sample

    @property
    def has_room(self) -> bool:
        """Whether the receiver can take more; without a receiver the inlet can always be read."""
        receiver = self._receiver
        return receiver is None or not receiver.is_full

    def begin(self, receiver: Receiver, *, is_clock_known: bool) -> None:
        """Deliver to this receiver from now on, and no longer to the previous one."""
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
        """Notify the receiver that the sender's clock has been measured."""
        with self._lock:
            if self._receiver is not None:
                self._receiver.clock_known()

    def end(self, undelivered: int = 0) -> None:
        """Notify the receiver of the stream's end, and of how many samples LSL dropped."""
        with self._lock:
            self._end(undelivered)

    def end_unless_heard(self, since_s: float) -> bool:
        """End the delivery unless samples came after a monotonic time; return whether it ended."""
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
    """Pulls samples from an inlet and delivers them; for one thread at a time.

    Parameters
    ----------
    lsl
        The inlet, which gives numpy arrays.
    """

    def __init__(self, lsl: pylsl.StreamInlet, delivery: Delivery) -> None:
        self.lsl = lsl
        self._delivery = delivery
        self._puller = Puller(lsl, BATCH_SAMPLES)

    @property
    def waiting(self) -> int:
        """Number of samples in the inlet's buffer."""
        return self._puller.waiting

    def drain(self, is_to_go_on: Condition) -> None:
        """Deliver all buffered samples without waiting, while *is_to_go_on* returns true.

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
        """Deliver each sample as it arrives, while *is_to_go_on* returns true.

        Samples of one packet are delivered together, because they share a stamped message.

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
