"""Takes samples out of liblsl's inlets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pylsl
from numpy.typing import NDArray

from biosensor_common import announcements
from lsl_to_ros.lsl.blocks import Block
from lsl_to_ros.lsl.liblsl import WaitingNumbers


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
