"""Stream and answers of a Shimmer; the first byte says how the device was set up.

Nothing raises; a message is never longer than what may be held back; data packets have
the channels that were announced; the messages do not depend on how the bytes were cut.
"""

from __future__ import annotations

from collections.abc import Sequence

from biosensor_gateway.devices.shimmer.driver.battery import charge_percent
from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.crc import CrcMode, checksum
from biosensor_gateway.devices.shimmer.driver.messages import (
    BatteryReading,
    Inquiry,
    Message,
    Packet,
)
from biosensor_gateway.devices.shimmer.driver.protocol import TICK_MODULUS, ShimmerProtocol
from biosensor_gateway.devices.shimmer.driver.replies import ReplyForm
from biosensor_gateway.devices.shimmer3_gsr.driver.emitter import GsrEmitter, Measurement
from tests.fuzz.checked_sink import ARRIVAL_S, CheckedSink
from tests.fuzz.contract import ensure
from tests.fuzz.streams import same_in_any_split

_CHANNELS = ((0x12, 0x1C), (0x03, 0x12, 0x1C), (0x1B, 0x0A, 0x1C, 0x12))
_DIVISORS = (256, 512, 64)
_FORMS = (ReplyForm(), ReplyForm(setup_bytes=7), ReplyForm(setup_bytes=7, status_bytes=2))
_MODES = tuple(CrcMode)
# An inquiry with all 48 channels, its acknowledgement and checksum, and one byte more.
_LARGEST = 1 + 12 + 48 + 2 + 1


def check(data: bytes) -> None:
    """Read the bytes behind the first, then with the checksums of its packets set right."""
    setup = data[0] if data else 0
    mode, form = _MODES[setup % 3], _FORMS[setup // 3 % 3]
    streams = setup // 9 % 4
    layout = Layout(_CHANNELS[streams]) if streams < len(_CHANNELS) else None
    divisor = _DIVISORS[setup // 36 % 3]

    def read(pieces: Sequence[bytes]) -> tuple[list[Message], int]:
        protocol = ShimmerProtocol()
        protocol.crc, protocol.form = mode, form
        if layout is not None:
            protocol.expect_data(layout, divisor)
        return _read(protocol, pieces)

    stream = data[1:]
    size = None if layout is None else 4 + layout.size
    for each in dict.fromkeys((stream, _with_right_checksums(stream, size, mode))):
        messages, _ = same_in_any_split(each, read)
        _are_sane(messages, layout)
        if layout is not None:
            _emit(messages, layout, divisor)


def _read(protocol: ShimmerProtocol, pieces: Sequence[bytes]) -> tuple[list[Message], int]:
    found = [stamped for piece in pieces for stamped in protocol.feed(piece, ARRIVAL_S)]
    ensure(protocol.buffered <= _LARGEST, "more than a message is held back", protocol.buffered)
    found += protocol.settle()
    ensure(not protocol.undecided, "something is undecided in silence")
    found += protocol.give_up()
    ensure(protocol.buffered == 0, "bytes are left after giving up", protocol.buffered)
    fed = sum(len(piece) for piece in pieces)
    ensure(protocol.dropped_bytes + len(found) <= fed, "more was read than came", fed, found)
    ensure({each.arrival_s for each in found} <= {ARRIVAL_S}, "an arrival was made up", found)
    return [each.message for each in found], protocol.dropped_bytes


def _are_sane(messages: Sequence[Message], layout: Layout | None) -> None:
    for message in messages:
        if isinstance(message, Packet):
            ensure(0 <= message.ticks < TICK_MODULUS, "no such time", message)
            expected = layout.channels if layout is not None else ()
            ensure(len(message.values) == len(expected), "channels are missing", message)
        elif isinstance(message, Inquiry):
            ensure(0 <= message.gsr_range < 8, "no such range", message)
            ensure(message.expansion_power in (True, False), "neither on nor off", message)
        elif isinstance(message, BatteryReading):
            level = charge_percent(message)
            ensure(level is None or 0 <= level <= 100, "no such level", message, level)


def _emit(messages: Sequence[Message], layout: Layout, divisor: int) -> None:
    for setting in (4, 0):
        emitter = GsrEmitter(CheckedSink("shimmer3_gsr"))
        emitter.started(Measurement(layout, divisor, setting))
        packets = [message for message in messages if isinstance(message, Packet)]
        period_s = divisor / 32768
        emitter.take((each, ARRIVAL_S + at * period_s) for at, each in enumerate(packets))


def _with_right_checksums(data: bytes, packet_size: int | None, mode: CrcMode) -> bytes:
    """Mutations nearly always break the checksum, and then test nothing behind it."""
    repaired = bytearray(data)
    step = (packet_size or 0) + mode
    if packet_size is None or mode is CrcMode.OFF:
        return data
    for start in range(0, len(repaired) - step + 1, step):
        end = start + packet_size
        repaired[end : end + mode] = checksum(bytes(repaired[start:end]), mode)
    return bytes(repaired)
