"""Datagrams of an EmotiBit: lines of text, from packets to samples.

Nothing raises; no more bytes are dropped than came; what is emitted has the declared shape and
finite times; no negative number of samples is lost; times of a stream never turn back.
"""

from __future__ import annotations

import math

from biosensor_gateway.devices.emotibit.driver.emitter import (
    EmotiBitEmitter,
    Oscillator,
    SensorRows,
)
from biosensor_gateway.devices.emotibit.driver.protocol import NUMBERS, read
from tests.fuzz.breaking import Fault, always
from tests.fuzz.checked_sink import ARRIVAL_S, CheckedSink
from tests.fuzz.contract import ensure
from tests.fuzz.seeding import Seeds, vectors
from tests.fuzz.streams import counted_pieces, join_counted

_ROUND_S = 0.1


def check(data: bytes) -> None:
    """Read datagrams in their order; an empty one stands for a new connection."""
    emitter = EmotiBitEmitter(CheckedSink("emotibit"), 25)
    rows = SensorRows(25, 2, Oscillator(25, 0.0))
    newest_s = -1.0
    for number, piece in enumerate(counted_pieces(data)):
        if not piece:
            emitter.connected()
            continue
        found = read(piece)
        ensure(0 <= found.dropped_bytes <= len(piece), "more is dropped than came", found)
        emitter.take(found.packets, ARRIVAL_S + number * _ROUND_S)
        for packet in found.packets:
            ensure(packet.number < NUMBERS, "no such number", packet)
            newest_s = max(newest_s + 1e-3, packet.time_ms / 1000)
            values = packet.values()
            if values:
                rows.add(packet.number % 2, values, newest_s, gap=bool(packet.number % 3))
                _check_rows(rows)


def _check_rows(rows: SensorRows) -> None:
    ready = rows.ready()
    ensure(ready.lost >= 0, "a negative number is lost", ready)
    ensure(len(ready.times_s) == len(ready.values), "not every sample has a time", ready)
    ensure(ready.times_s == sorted(ready.times_s), "times run backwards", ready)


def seeds() -> Seeds:
    """Return the vectors, one by one and together."""
    texts = [
        (vector["name"], vector["text"].encode())
        for vector in vectors("emotibit/vectors/emotibit_packets.json")
    ]
    for name, text in texts:
        yield name, join_counted([text])
    yield "all", join_counted([text for _, text in texts])
    real = [text for name, text in texts if name.startswith("real_")]
    yield "again", join_counted([b"".join(real[:9]), b"", b"".join(real[9:]), *real])


FAULT: Fault = (
    "biosensor_gateway.devices.emotibit.driver.emitter.Oscillator",
    "time_s",
    always(math.nan),
)
"""How the reader is broken to see that the corpus finds it."""
