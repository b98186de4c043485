"""Takes samples out of liblsl's inlets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pylsl
from numpy.typing import NDArray

from biosensor_common import announcements
from lsl_to_ros.lsl.blocks import Block


def pull_one(lsl: pylsl.StreamInlet, timeout_s: float) -> Block | None:
    """Take one sample, None if it does not come in time; a chunk of one costs twice as much."""
    sample, stamp = lsl.pull_sample(timeout_s)
    return None if sample is None else Block(sample[np.newaxis], np.array([stamp]))


def pull(lsl: pylsl.StreamInlet, count: int) -> Block:
    """Take at most *count* samples of those that have come; maybe none."""
    samples, stamps = lsl.pull_chunk(0.0, count)
    return Block(samples, stamps)


def decoded(samples: NDArray[Any]) -> NDArray[Any]:
    """Decode each text."""
    decoded = np.empty_like(samples)
    for place, text in np.ndenumerate(samples):
        decoded[place] = announcements.decoded(text)
    return decoded
