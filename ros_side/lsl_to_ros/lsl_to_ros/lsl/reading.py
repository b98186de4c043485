"""Reads one of liblsl's inlets: what has come, or each sample as it comes."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pylsl
from numpy.typing import NDArray

from biosensor_common.lsl import header
from lsl_to_ros.topics.runs import Block, joined
from lsl_to_ros.lsl.delivery import Delivery
from lsl_to_ros.lsl.liblsl import WaitingNumbers, samples_available

# How long a blocked pull keeps its thread from noticing that it should end.
PULL_TIMEOUT_S = 0.2
# A receiver that is full is looked at again after so long.
ROOM_S = 0.01
BATCH_SAMPLES = 1024

Condition = Callable[[], bool]


class Reading:
    """Takes samples out of an inlet and delivers them; one thread at a time may call it.

    Parameters
    ----------
    lsl
        The inlet, which gives numpy arrays.
    is_text
        Whether its samples are texts.

    Attributes
    ----------
    lsl
        As it was given.
    """

    def __init__(self, lsl: pylsl.StreamInlet, delivery: Delivery, *, is_text: bool) -> None:
        self.lsl = lsl
        self._delivery = delivery
        self._is_text = is_text
        self._pull = Puller(lsl, BATCH_SAMPLES).pull

    @property
    def waiting(self) -> int:
        """Samples that have come and that nobody has taken yet."""
        return samples_available(self.lsl)

    def drain(self, is_to_go_on: Condition) -> None:
        """Deliver what has come, without waiting, for as long as that is wanted.

        Raises
        ------
        LostError
            The stream has ended.
        """
        while is_to_go_on():
            # At least one is asked for, because only a pull finds out about a loss.
            wanted = min(max(self.waiting, 1), BATCH_SAMPLES)
            block = self._pull(wanted)
            if len(block.stamps):
                self._deliver(block)
            if wanted < BATCH_SAMPLES:
                return  # nothing is dropped: all that had come is delivered

    def follow(self, is_to_go_on: Condition) -> None:
        """Deliver each sample as it comes, for as long as that is wanted.

        Raises
        ------
        LostError
            The stream has ended.
        """
        while is_to_go_on():
            if not self._delivery.has_room:
                time.sleep(ROOM_S)
                continue  # nothing is dropped: they wait in liblsl
            block = pull_one(self.lsl, PULL_TIMEOUT_S)
            if block is not None:
                self._deliver_with_what_waits(block)

    def _deliver_with_what_waits(self, block: Block) -> None:
        waiting = min(self.waiting, BATCH_SAMPLES)
        try:
            # What came in one packet belongs into one message where there is such.
            block = joined(block, self._pull(waiting)) if waiting else block
        finally:
            # The pull may find out that the stream is lost.
            self._deliver(block)

    def _deliver(self, block: Block) -> None:
        if self._is_text:
            block = Block(decoded(block.samples), block.stamps)
        self._delivery.deliver(block)


def pull_one(lsl: pylsl.StreamInlet, timeout_s: float) -> Block | None:
    """Wait for one sample; None if it does not come in time.

    Raises
    ------
    LostError
        The stream has ended.
    """
    sample, stamp = lsl.pull_sample(timeout_s)
    return None if sample is None else Block(sample[np.newaxis], np.array([stamp]))


class Puller:
    """Takes what has come out of one inlet, without waiting; for one thread at a time.

    Numbers are written where they are written each time, and copied from there: to make an array
    and ask for its address takes several times as long as liblsl takes for a few samples.

    Parameters
    ----------
    most
        Samples that are ever asked for at once.
    """

    def __init__(self, lsl: pylsl.StreamInlet, most: int) -> None:
        self._lsl = lsl
        self._numbers = WaitingNumbers.of(lsl, most)

    def pull(self, count: int) -> Block:
        """Take at most *count* samples of those that have come; maybe none.

        Raises
        ------
        LostError
            The stream has ended.
        """
        numbers = self._numbers
        if numbers is None:
            samples, stamps = self._lsl.pull_chunk(0.0, count)
            return Block(samples, stamps)
        taken = numbers.take(count)
        return Block(numbers.samples[:taken].copy(), numbers.stamps[:taken].copy())


def decoded(samples: NDArray[Any]) -> NDArray[Any]:
    """Decode each text."""
    decoded = np.empty_like(samples)
    for place, text in np.ndenumerate(samples):
        decoded[place] = announcements.decoded(text)
    return decoded
