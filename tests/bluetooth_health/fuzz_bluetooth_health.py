"""Values of the standard services for health and sports.

Nothing raises; samples have the declared shape; each value is read as of every service.
"""

from __future__ import annotations

from biosensor_gateway.devices.bluetooth_health.driver import HealthEmitter
from biosensor_gateway.devices.bluetooth_health.driver.services import ROWS, long_float, sfloat
from tests.fuzz.breaking import Fault, always
from tests.fuzz.checked_sink import ARRIVAL_S, CheckedSink
from tests.fuzz.contract import ensure
from tests.fuzz.seeding import Seeds, counted, hex_of, vectors
from tests.fuzz.streams import counted_pieces

_LARGEST_SFLOAT = 2e10 + 5e8
_DECIMALS = 4


def check(data: bytes) -> None:
    """Read the values in their order, each as of every service."""
    emitter = HealthEmitter(CheckedSink("bluetooth_health"), 2.105)
    for number, piece in enumerate(counted_pieces(data)):
        for row in ROWS:
            emitter.take(row, piece, ARRIVAL_S + number)
        if len(piece) >= _DECIMALS:
            short = sfloat(piece[:2])
            ensure(not abs(short) > _LARGEST_SFLOAT, "no such decimal number", short)
            long_float(piece[:_DECIMALS])


def seeds() -> Seeds:
    """Return the vectors, one by one and together."""
    return counted(hex_of(vectors("bluetooth_health/vectors/bluetooth_health.json")))


FAULT: Fault = (
    "biosensor_gateway.devices.bluetooth_health.driver.services",
    "_celsius",
    always([0.0, 0.0]),
)
"""How the reader is broken to see that the corpus finds it."""
