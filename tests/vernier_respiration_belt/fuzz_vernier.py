"""Go Direct packets of a respiration belt, and what its replies say.

Nothing raises; every byte is in a packet, dropped and counted, or held back; no more
than one packet is held back; all channels of a measurement have as many samples; the
result does not depend on how the bytes were cut.
"""

from __future__ import annotations

from collections.abc import Sequence

from biosensor_common.errors import ProtocolError
from biosensor_gateway.devices.vernier_respiration_belt.driver.conversation import (
    BeltChannels,
    choose_channels,
)
from biosensor_gateway.devices.vernier_respiration_belt.driver.emitter import VernierEmitter
from biosensor_gateway.devices.vernier_respiration_belt.driver.protocol import (
    HEADER_SIZE,
    Channel,
    Head,
    Measurement,
    Message,
    PacketParser,
    Reply,
    VernierProtocol,
    parse_channel,
    parse_device_info,
    parse_mask,
    parse_status,
)
from tests.fuzz.breaking import Fault, forgets_what_it_holds
from tests.fuzz.checked_sink import ARRIVAL_S, CheckedSink
from tests.fuzz.contract import ensure
from tests.fuzz.seeding import Seeds, hex_of, vectors
from tests.fuzz.streams import same_in_any_split

_LARGEST = 255
_HEADS = (Head.REPLY, Head.MEASUREMENT)
_WANTED_US = 100_000
_PERIOD_S = 0.1
_FORCE, _RATE = (Channel(number, "", "", 10_000, 10_000_000, 1000) for number in (1, 2))


def check(data: bytes) -> None:
    """Read the bytes as they are, then with every packet's checksum set right."""
    for stream in dict.fromkeys((data, _with_right_checksums(data))):
        _account_for_bytes(stream)
        messages, *_ = same_in_any_split(stream, _read)
        _read_replies([message.payload for message in messages if isinstance(message, Reply)])
        _emit(messages)


def _account_for_bytes(stream: bytes) -> None:
    parser = PacketParser()
    packets = [*parser.feed(stream), *parser.give_up()]
    size, dropped = sum(len(packet.data) for packet in packets), parser.dropped_bytes
    ensure(size + dropped == len(stream), "bytes are lost", len(stream), size, dropped)


def _read(pieces: Sequence[bytes]) -> tuple[list[Message], int, int]:
    protocol = VernierProtocol()
    found = [message for piece in pieces for message in protocol.feed(piece)]
    held = protocol.buffered
    ensure(held < _LARGEST, "more than a packet is held back", held)
    found += protocol.give_up()
    ensure(protocol.buffered == 0, "bytes are left after giving up", protocol.buffered)
    return found, held, protocol.dropped_bytes


def _read_replies(payloads: Sequence[bytes]) -> None:
    channels: list[Channel] = []
    for payload in payloads:
        parse_status(payload)
        parse_device_info(payload)
        parse_mask(payload)
        channel = parse_channel(payload)
        channels += [channel] if channel is not None else []
    try:
        chosen = choose_channels(channels)
    except ProtocolError:
        return
    least = max(chosen.force.min_period_us, chosen.rate.min_period_us)
    period_us = chosen.period_us(_WANTED_US)
    ensure(period_us >= least, "the period is shorter than the belt can", period_us, chosen)


def _emit(messages: Sequence[Message]) -> None:
    emitter = VernierEmitter(CheckedSink("vernier_respiration_belt"))
    emitter.started(BeltChannels(_FORCE, _RATE), _PERIOD_S)
    for number, message in enumerate(messages):
        if isinstance(message, Measurement):
            counts = {len(values) for values in message.samples.values()}
            ensure(len(counts) < 2, "channels differ in length", message)
        emitter.take(message, ARRIVAL_S + number)
    emitter.ended()


def _with_right_checksums(data: bytes) -> bytes:
    """Mutations nearly always break the checksum, and then test nothing behind it."""
    repaired = bytearray(data)
    at = 0
    while at + HEADER_SIZE < len(repaired):
        end = at + repaired[at + 1]
        if repaired[at] not in _HEADS or not at + HEADER_SIZE < end <= len(repaired):
            at += 1
            continue
        repaired[at + 3] = 0
        repaired[at + 3] = sum(repaired[at:end]) & 0xFF
        at = end
    return bytes(repaired)


def seeds() -> Seeds:
    """Return the vectors, one by one and together."""
    named = list(hex_of(vectors("vernier_respiration_belt/vectors/vernier_gdxrb.json")))
    said = [(name, data) for name, data in named if data[0] != 0x58]
    yield from said
    yield "all", b"".join(data for _, data in said)


FAULT: Fault = (
    "biosensor_gateway.devices.vernier_respiration_belt.driver.protocol.PacketParser",
    "feed",
    forgets_what_it_holds,
)
"""How the reader is broken to see that the corpus finds it."""
