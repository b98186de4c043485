"""The E4 target without one guard: a decimal mark that was lost makes a time of no clock.

Not part of a campaign: it is there to see that a campaign finds what is broken.
"""

from __future__ import annotations

import math

from biosensor_gateway.devices.empatica_e4.driver import protocol
from tests.empatica_e4 import fuzz_empatica_e4 as empatica_e4

HARMLESS = b"E4_Bvp 1680442024,64479 21,54169\r\nE4_Acc 1680442024,5 -1 2 63\r\n"
"""An input that does not show it."""


def check(data: bytes) -> None:
    """Read the bytes with the guard taken away."""
    guard, protocol.MAX_TIME_S = protocol.MAX_TIME_S, math.inf
    try:
        empatica_e4.check(data)
    finally:
        protocol.MAX_TIME_S = guard
