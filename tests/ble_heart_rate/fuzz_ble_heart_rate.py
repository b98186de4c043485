"""Values of the heart-rate service's characteristics.

Nothing raises; intervals are as many as there are bytes for; beats are in order and
never after their packet; a battery level is a percentage; texts can be printed.
"""

from __future__ import annotations

from biosensor_gateway.devices.ble_heart_rate.driver.beats import BeatClock
from biosensor_gateway.devices.ble_heart_rate.driver.emitter import StrapEmitter
from biosensor_gateway.devices.ble_heart_rate.driver.protocol import (
    parse_battery_level,
    parse_measurement,
    parse_text,
)
from tests.fuzz.breaking import Fault, instead
from tests.fuzz.checked_sink import ARRIVAL_S, CheckedSink
from tests.fuzz.contract import ensure
from tests.fuzz.seeding import Seeds, counted, hex_of, vectors
from tests.fuzz.streams import counted_pieces, join_counted

_ROUNDING_S = 1e-6


def check(data: bytes) -> None:
    """Read the values in their order, as of one connection."""
    beats = BeatClock()
    emitter = StrapEmitter(CheckedSink("ble_heart_rate"))
    for number, piece in enumerate(counted_pieces(data)):
        arrival_s = ARRIVAL_S + number
        _check_measurement(piece, beats, arrival_s)
        level = parse_battery_level(piece)
        ensure(level is None or 0 <= level <= 100, "no such level", level)
        text = parse_text(piece)
        ensure(text.isprintable() and text == text.strip(), "not to be printed", text)
        emitter.measurement(piece, arrival_s)
        emitter.battery(piece, arrival_s)


def _check_measurement(piece: bytes, beats: BeatClock, arrival_s: float) -> None:
    measured = parse_measurement(piece)
    if measured is None:
        return
    ensure(2 * len(measured.intervals) < len(piece), "more intervals than bytes", measured)
    ensure(0 <= measured.bpm <= 0xFFFF, "no such rate", measured)
    times = beats.place(measured.intervals_s, arrival_s)
    ensure(len(times) == len(measured.intervals), "not every beat has a time", measured, times)
    ensure(times == sorted(times), "beats run backwards", times)
    ensure(max(times, default=0.0) <= arrival_s + _ROUNDING_S, "a beat is in the future", times)


def seeds() -> Seeds:
    """Return the vectors, one by one and together."""
    yield from counted(hex_of(vectors("ble_heart_rate/vectors/ble_heart_rate.json")))
    yield "batteries", join_counted([b"\x00", b"\x64", b"\x65", b"\xff"])
    yield "texts", join_counted([b"Polar H10\0", b" 3.1.1\n", b"\xff\xc3\xa4"])


def _any_byte(data: bytes) -> int | None:
    return data[0] if data else None


FAULT: Fault = (
    "tests.ble_heart_rate.fuzz_ble_heart_rate",
    "parse_battery_level",
    instead(_any_byte),
)
"""How the reader is broken to see that the corpus finds it."""
