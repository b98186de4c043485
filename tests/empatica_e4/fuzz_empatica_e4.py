"""Lines of the E4 streaming server.

Nothing raises; what waits for its line end is no longer than a line may be; samples are
finite numbers, as many as the stream has; the messages do not depend on how the bytes
were cut.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from biosensor_gateway.devices.empatica_e4.driver.emitter import E4Emitter
from biosensor_gateway.devices.empatica_e4.driver.protocol import (
    MAX_LINE_BYTES,
    E4Protocol,
    Event,
    Message,
    Sample,
    Stream,
)
from tests.fuzz.breaking import Fault, instead
from tests.fuzz.checked_sink import ARRIVAL_S, CheckedSink
from tests.fuzz.contract import ensure
from tests.fuzz.seeding import Seeds, vectors
from tests.fuzz.streams import same_in_any_split

# Vectors that test size alone are tested elsewhere.
_MAX_BYTES = 8192

_VALUES = {Stream.ACC: 3, Stream.TAG: 0}


def check(data: bytes) -> None:
    """Read the bytes, and emit the samples."""
    messages, _ = same_in_any_split(data, _read)
    for message in messages:
        if isinstance(message, Sample):
            ensure(len(message.values) == _VALUES.get(message.stream, 1), "bad count", message)
            numbers = (message.time_s, *message.values)
            ensure(all(map(math.isfinite, numbers)), "it is no number", message)
        elif isinstance(message, Event):
            ensure(message.device != "", "an event of no device", message)
    _emit(messages)


def _read(pieces: Sequence[bytes]) -> tuple[list[Message], int]:
    protocol = E4Protocol()
    found: list[Message] = []
    for piece in pieces:
        found += protocol.feed(piece)
        ensure(protocol.buffered <= MAX_LINE_BYTES, "too much is held back", protocol.buffered)
    found += protocol.finish()
    ensure(protocol.buffered == 0, "bytes are left at the end", protocol.buffered)
    fed = sum(len(piece) for piece in pieces)
    ensure(0 <= protocol.dropped_bytes <= fed, "more is dropped than came", protocol.dropped_bytes)
    return found, protocol.dropped_bytes


def _emit(messages: Sequence[Message]) -> None:
    emitter = E4Emitter(CheckedSink("empatica_e4"))
    for number, message in enumerate(messages):
        if isinstance(message, Sample):
            emitter.take([message], ARRIVAL_S + number)
        elif isinstance(message, Event):
            emitter.new_epoch()


def seeds() -> Seeds:
    """Return the vectors, one by one and together."""
    for vector in vectors("empatica_e4/vectors/empatica_e4.json"):
        parts = vector.get("chunks") or [vector["message"]]
        if isinstance(parts, str):
            continue
        data = b"".join(
            bytes.fromhex(part[4:]) if part.startswith("hex:") else part.encode() for part in parts
        )
        if len(data) < _MAX_BYTES:
            yield vector["name"], data
    yield "odd_digits", "R device_list \u00b2 | a\nE4_Bvp \u0661 2\nE4_Bvp 1\u00b2 2\n".encode()
    yield "odd_length_of_number", b"E4_Bvp 1 " + b"9" * 5000 + b"\n"


def _any_number(word: str) -> float:
    return float(word.replace(",", "."))


FAULT: Fault = (
    "biosensor_gateway.devices.empatica_e4.driver.protocol",
    "_number",
    instead(_any_number),
)
"""How the reader is broken to see that the corpus finds it."""
