"""Stream and answers of a Shimmer; the first byte says how the device was set up.

Nothing raises; a message is never longer than what may be held back; data packets have
the channels that were announced; the messages do not depend on how the bytes were cut.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence

import numpy as np

from biosensor_gateway.devices.shimmer.driver import (
    Measurement,
    ShimmerEmitter,
    typical_calibrations,
)
from biosensor_gateway.devices.shimmer.driver.calibration import (
    GAINS,
    Block,
    Exg,
    Use,
    registers_for,
    stored,
)
from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.conversation import Kind
from biosensor_gateway.devices.shimmer.driver.messages import (
    BatteryReading,
    Calibration,
    CrcMode,
    ExgRegisters,
    Firmware,
    Inquiry,
    Message,
    Packet,
    PressureChip,
    PressureCoefficients,
    ReplyForm,
    checksum,
)
from biosensor_gateway.devices.shimmer.driver.packets import charge_percent
from biosensor_gateway.devices.shimmer.driver.protocol import TICK_MODULUS, ShimmerProtocol
from biosensor_gateway.devices.shimmer.driver.signals import (
    air_signals,
    compensation,
    exg_signal,
    motion_signals,
    status_places,
)
from biosensor_gateway.devices.shimmer3_gsr import driver as gsr
from tests.fuzz.breaking import Fault, forgets_what_it_holds
from tests.fuzz.checked_sink import ARRIVAL_S, CheckedSink
from tests.fuzz.contract import ensure
from tests.fuzz.seeding import Seeds, hex_of, vectors
from tests.fuzz.streams import same_in_any_split

_OF_GSR = ((0x12, 0x1C), (0x03, 0x12, 0x1C), (0x1B, 0x0A, 0x1C, 0x12))
_AIR, _EXG_24, _EXG_16 = (0x1A, 0x1B), (*range(0x1D, 0x23),), (0x1D, 0x23, 0x24)
_OF_FAMILY = (
    (0, 1, 2, 10, 11, 12, 4, 5, 6, 7, 8, 9, *_AIR, *_EXG_24),
    (0, 1, 2, 3, 7, 9, 8, *_AIR, *_EXG_16),
    (7, 8, 9, 10, 11, 12, 0, 1, 2, *_AIR[::-1], *_EXG_24),
)
_DIVISORS = (256, 512, 64)
_FORMS = (
    ReplyForm(),
    ReplyForm(setup_bytes=7),
    ReplyForm(setup_bytes=7, status_bytes=2, calibration_blocks=6),
)
_MODES = tuple(CrcMode)
# An inquiry with all 48 channels or six calibrations, acknowledgement, checksum, one byte more.
_LARGEST = 1 + max(12 + 48, 1 + 6 * 21) + 2 + 1


def check(data: bytes) -> None:
    """Read the bytes behind the first, then with the checksums of its packets set right."""
    setup = data[0] if data else 0
    mode, form = _MODES[setup % 3], _FORMS[setup // 3 % 3]
    streams = setup // 9 % 4
    is_of_family = setup // 108 % 2 == 1
    chosen = (_OF_FAMILY if is_of_family else _OF_GSR)[streams : streams + 1]
    layout = next((Layout(each, is_3r=is_of_family and streams == 2) for each in chosen), None)
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
        if layout is not None and is_of_family:
            _emit_all(messages, layout, divisor)
        elif layout is not None:
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
        elif isinstance(message, Calibration):
            for block in Block:
                found = stored(message.data, block)
                ensure(
                    found is None or bool(np.isfinite(found.matrix).all()),
                    "no calibration",
                    message,
                )
        elif isinstance(message, PressureCoefficients):
            compensation(message, 3)
        elif isinstance(message, ExgRegisters):
            registers = message.data.ljust(10, b"\0")
            ensure(Exg((registers, registers)).gain(0, 1) in GAINS, "no such gain", message)
        elif isinstance(message, BatteryReading):
            level = charge_percent(message)
            ensure(level is None or 0 <= level <= 100, "no such level", message, level)


def _emit(messages: Sequence[Message], layout: Layout, divisor: int) -> None:
    for setting in (4, 0):
        emitter = gsr.GsrEmitter(CheckedSink("shimmer3_gsr"))
        emitter.started(gsr.Measurement(layout, divisor, setting))
        packets = [message for message in messages if isinstance(message, Packet)]
        period_s = divisor / 32768
        emitter.take((each, ARRIVAL_S + at * period_s) for at, each in enumerate(packets))


def _emit_all(messages: Sequence[Message], layout: Layout, divisor: int) -> None:
    kind = Kind(3, Firmware(3, (1, 1, 2)))
    calibrations = typical_calibrations(kind, layout, Inquiry(divisor, bytes(4), ()), None)
    air = compensation(PressureCoefficients(PressureChip.BMP581, b""), 0)
    ensure(air is not None, "no compensation")
    assert air is not None
    exg = exg_signal(layout, Exg(registers_for(Use.ECG, 4, 128.0, lead_off=True)))
    signals = (exg, *motion_signals(layout, calibrations), *air_signals(layout, air))
    emitter = ShimmerEmitter(CheckedSink("shimmer"))
    emitter.started(Measurement(layout, divisor, signals, status_places(layout)))
    packets = [message for message in messages if isinstance(message, Packet)]
    emitter.take((each, ARRIVAL_S + at * divisor / 32768) for at, each in enumerate(packets))


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


def seeds() -> Seeds:
    """Each vector in the three checksum modes; the first byte is what `shimmer3` makes of it."""
    found = [
        vector
        for vector in vectors("shimmer3_gsr/vectors/shimmer3.json")
        if vector["kind"] in ("response", "data", "stream", "command")
    ]
    for name, data in hex_of(found):
        for setup in (0, 1, 2, 9, 11, 20, 27, 29):
            yield f"{name}_{setup}", bytes((setup,)) + data
    for mode in range(3):
        yield f"packets_{mode}", bytes((mode + 36,)) + _shimmer_packets()
    yield from _shimmer_family()


def _shimmer_family() -> Iterator[tuple[str, bytes]]:
    """What a device's memory tells, and packets of all its sensors."""
    for vector in vectors("shimmer/vectors/shimmer.json"):
        data, name = bytes.fromhex(vector["hex"]), vector["name"]
        if vector["kind"] == "block":
            yield f"memory_{name}", bytes((33,)) + b"\xff\x2d" + 6 * data
        elif vector["kind"] == "registers":
            yield f"registers_{name}", bytes((27,)) + b"\xff\x62\x0a" + data
        elif vector["kind"] == "air":
            said = bytes((0xFF, 0xA6, 1 + len(data), vector["chip"]))
            yield f"air_{name}", bytes((27,)) + said + data
    for streams, size in enumerate((43, 24, 38)):
        packets = (
            b"\0" + (256 * at).to_bytes(3, "little") + bytes(range(at, at + size))
            for at in range(12)
        )
        yield f"all_sensors_{streams}", bytes((108 + 9 * streams,)) + b"".join(packets)


def _shimmer_packets() -> bytes:
    ticks = range(0xFFF000, 0xFFF000 + 40 * 512, 512)
    return b"".join(
        b"\0" + (tick & 0xFFFFFF).to_bytes(3, "little") + struct.pack("<HH", 2000 + at, 0x4800 + at)
        for at, tick in enumerate(ticks)
    )


FAULT: Fault = (
    "biosensor_gateway.devices.shimmer.driver.protocol.ShimmerProtocol",
    "feed",
    forgets_what_it_holds,
)
"""How the reader is broken to see that the corpus finds it."""
