"""Manufacturer data of advertisements.

Nothing raises; a rate is a byte that was advertised; what is heard again is no sample.
"""

from __future__ import annotations

from biosensor_gateway.devices.polar_broadcast.driver import BroadcastEmitter
from biosensor_gateway.devices.polar_broadcast.driver.protocol import COUNTS, Broadcast, parse
from tests.fuzz.breaking import Fault, instead
from tests.fuzz.checked_sink import ARRIVAL_S, CheckedSink
from tests.fuzz.contract import ensure
from tests.fuzz.seeding import Seeds, counted, hex_of, vectors
from tests.fuzz.streams import counted_pieces, join_counted


def check(data: bytes) -> None:
    """Hear the advertisements one after the other, each twice."""
    emitter = BroadcastEmitter(CheckedSink("polar_broadcast"))
    for number, piece in enumerate(counted_pieces(data)):
        broadcast = parse(piece)
        if broadcast is not None:
            ensure(0 <= broadcast.counter < COUNTS, "no such number", broadcast)
            ensure({broadcast.bpm} <= set(piece), "a rate that was not advertised", broadcast)
        for again_s in (0.0, 0.5):
            emitter.heard(piece, ARRIVAL_S + number + again_s, -60)


def seeds() -> Seeds:
    """Return the vectors, one by one and together."""
    yield from counted(hex_of(vectors("polar_broadcast/vectors/advertisements.json")))
    turns = [bytes((0x23 | number << 2, 0, 70, 71)) for number in range(COUNTS)]
    yield "a turn of the counter", join_counted(turns)


def _off_by_one(data: bytes) -> Broadcast | None:
    found = parse(data)
    return None if found is None else found._replace(counter=found.counter + 1)


FAULT: Fault = ("tests.polar_broadcast.fuzz_polar_broadcast", "parse", instead(_off_by_one))
"""How the reader is broken to see that the corpus finds it."""
