"""Looks for streams on the network until enough of them have answered.

They answer in waves, and of many some answer late, so nobody relies on one look.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import pylsl

from biosensor_common.lsl.predicates import EVERYTHING

LOOK_EVERY_S = 0.1

Streams = Mapping[str, pylsl.StreamInfo]
"""By their uids."""


def search(
    is_enough: Callable[[Streams, float], bool], predicate: str = EVERYTHING
) -> list[pylsl.StreamInfo]:
    """Look until it is enough; return all streams that answered, also those that have ended since.

    Parameters
    ----------
    is_enough
        Is given what has answered so far, and since how many seconds it is looked for.
    """
    resolver = pylsl.ContinuousResolver(pred=predicate)
    begun_s = time.monotonic()
    found: dict[str, pylsl.StreamInfo] = {}
    while True:
        time.sleep(LOOK_EVERY_S)
        # A resolver gives a stream anew at each look.
        found |= {info.uid(): info for info in resolver.results()}
        if is_enough(found, time.monotonic() - begun_s):
            return list(found.values())
