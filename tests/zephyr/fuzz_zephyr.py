"""BioHarness packets.

Nothing raises; every byte is in a frame, dropped and counted, or held back; no more than
one frame is held back; the result does not depend on how the bytes were cut.
"""

from __future__ import annotations

from collections.abc import Sequence

from biosensor_gateway.devices.zephyr.driver.emitter import ZephyrEmitter
from biosensor_gateway.devices.zephyr.driver.messages import Message
from biosensor_gateway.devices.zephyr.driver.protocol import (
    MAX_PAYLOAD,
    STX,
    FrameParser,
    ZephyrProtocol,
    crc8,
)
from tests.fuzz.breaking import Fault, forgets_what_it_holds
from tests.fuzz.checked_sink import ARRIVAL_S, CheckedSink
from tests.fuzz.contract import ensure
from tests.fuzz.seeding import TESTS, Seeds, hex_of, vectors
from tests.fuzz.streams import same_in_any_split

_RECORDINGS = TESTS.parent / "gateway_win/biosensor_gateway/devices/zephyr/simulator/recordings"
_CAPTURE_BYTES = 600

_OVERHEAD = 5
_LARGEST = MAX_PAYLOAD + _OVERHEAD


def check(data: bytes) -> None:
    """Read the bytes as they are, then with every frame's checksum set right."""
    for stream in dict.fromkeys((data, _with_right_checksums(data))):
        _account_for_bytes(stream)
        messages, *_ = same_in_any_split(stream, _read)
        _emit(messages)


def _account_for_bytes(stream: bytes) -> None:
    parser = FrameParser()
    frames = [*parser.feed(stream), *parser.give_up()]
    size = sum(len(frame.payload) + _OVERHEAD for frame in frames)
    dropped = parser.dropped_bytes
    ensure(size + dropped == len(stream), "bytes are lost", len(stream), size, dropped)


def _read(pieces: Sequence[bytes]) -> tuple[list[Message], int, int]:
    protocol = ZephyrProtocol()
    found = [message for piece in pieces for message in protocol.feed(piece)]
    held = protocol.buffered
    ensure(held < _LARGEST, "more than a frame is held back", held)
    found += protocol.give_up()
    ensure(protocol.buffered == 0, "bytes are left after giving up", protocol.buffered)
    return found, held, protocol.dropped_bytes


def _emit(messages: Sequence[Message]) -> None:
    emitter = ZephyrEmitter(CheckedSink("zephyr"))
    for number, message in enumerate(messages):
        emitter.take(message, ARRIVAL_S + number)


def _with_right_checksums(data: bytes) -> bytes:
    """Mutations nearly always break the checksum, and then test nothing behind it."""
    repaired = bytearray(data)
    at = 0
    while (at := repaired.find(STX, at)) >= 0 and at + 2 < len(repaired):
        end = at + _OVERHEAD + repaired[at + 2]
        if end > len(repaired):
            at += 1
            continue
        repaired[end - 2] = crc8(bytes(repaired[at + 3 : end - 2]))
        at = end
    return bytes(repaired)


def seeds() -> Seeds:
    """Return the vectors, one by one and together."""
    named = list(hex_of(vectors("zephyr/vectors/zephyr_bioharness.json")))
    yield from named
    for recording in sorted(_RECORDINGS.glob("*.dat")):
        content = recording.read_bytes()
        yield f"{recording.stem}_begin", content[:_CAPTURE_BYTES]
        middle = len(content) // 2
        yield f"{recording.stem}_middle", content[middle : middle + _CAPTURE_BYTES]


FAULT: Fault = (
    "biosensor_gateway.devices.zephyr.driver.protocol.FrameParser",
    "feed",
    forgets_what_it_holds,
)
"""How the reader is broken to see that the corpus finds it."""
