"""Messages of the GATT SensorData Protocol, with which a Movesense sensor sends everything.

Nothing raises; packets hold no more bytes than came; times are finite and in order; no
negative number of samples is lost.
"""

from __future__ import annotations

from biosensor_gateway.devices.movesense.driver.emitter import MovesenseEmitter, PacketSeries
from biosensor_gateway.devices.movesense.driver.protocol import (
    HEART_RATE,
    MOVEMENT,
    TEMPERATURE,
    Assembler,
    Kind,
    Measurement,
    ecg,
    is_refused_greeting,
    movement,
    parse_greeting,
    parse_message,
)
from tests.fuzz.breaking import Fault, always
from tests.fuzz.checked_sink import ARRIVAL_S, CheckedSink
from tests.fuzz.contract import ensure
from tests.fuzz.seeding import Seeds, counted, hex_of, vectors
from tests.fuzz.streams import counted_pieces

_LONGEST_VALUE = 512
_RATE_HZ, _COUNT = 200, 16
_MEASUREMENTS = (
    ecg(_RATE_HZ, in_millivolts=False),
    movement(MOVEMENT, 52),
    HEART_RATE,
    TEMPERATURE,
)


def check(data: bytes) -> None:
    """Read the messages in their order, as of one connection."""
    emitter = MovesenseEmitter(CheckedSink("movesense"), ())
    assemblers = {each.reference: _begin(emitter, each) for each in _MEASUREMENTS}
    wanted = {each.reference: each for each in _MEASUREMENTS}
    series = PacketSeries(_RATE_HZ)
    came = used = 0
    for number, piece in enumerate(counted_pieces(data)):
        message = parse_message(piece[:_LONGEST_VALUE])
        if message is None:
            continue
        _check_answer(message.payload)
        _check_times(series, message.payload)
        if message.kind is Kind.ANSWER or message.reference not in wanted:
            ensure(0 <= message.status <= 0xFFFF, "no such status", message)
            continue
        came += len(message.payload)
        for packet in assemblers[message.reference].take(message, ARRIVAL_S + number):
            used += len(packet.payload)
            emitter.take(wanted[message.reference], packet)
    dropped = sum(each.dropped_bytes for each in assemblers.values())
    ensure(used + dropped <= came, "packets hold more than came", came, used, dropped)


def _begin(emitter: MovesenseEmitter, measurement: Measurement) -> Assembler:
    emitter.started(measurement)
    return Assembler(measurement.full_bytes, measurement.sample_bytes)


def _check_answer(payload: bytes) -> None:
    greeting = parse_greeting(payload)
    texts = "".join(greeting[1:])
    ensure(texts.isprintable(), "not to be printed", greeting)
    is_refused_greeting(payload)


def _check_times(series: PacketSeries, payload: bytes) -> None:
    stamp_s = int.from_bytes(payload[:4], "little") / 1000
    placed = series.place(stamp_s, _COUNT)
    ensure(placed.lost >= 0, "a negative number is lost", placed.lost)
    ensure(len(placed.times_s) == _COUNT, "not every sample has a time", placed)
    ensure(placed.times_s == sorted(placed.times_s), "times run backwards", placed)


def seeds() -> Seeds:
    """Return the vectors, one by one and together."""
    return counted(hex_of(vectors("movesense/vectors/movesense_gsp.json")))


FAULT: Fault = (
    "biosensor_gateway.devices.movesense.driver.emitter.PacketSeries",
    "_missing",
    always(-1),
)
"""How the reader is broken to see that the corpus finds it."""
