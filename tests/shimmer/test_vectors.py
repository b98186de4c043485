"""Every vector of the family, and framing of any bytes in any pieces."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from biosensor_gateway.devices.shimmer.driver import calibration, typical_calibrations
from biosensor_gateway.devices.shimmer.driver.calibration import (
    Block,
    Exg,
    Use,
    microvolts,
    registers_for,
    stored,
)
from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.conversation import Kind
from biosensor_gateway.devices.shimmer.driver.messages import (
    Ack,
    BatteryReading,
    CrcMode,
    DaughterCard,
    Firmware,
    Hardware,
    Inquiry,
    Message,
    Nack,
    Packet,
    PressureChip,
    PressureCoefficients,
    ReplyForm,
    Status,
    StatusFlag,
    checksum,
)
from biosensor_gateway.devices.shimmer.driver.protocol import ShimmerProtocol
from biosensor_gateway.devices.shimmer.driver.signals import are_real, compensation, motion_signals

# Every vector of the family: bytes in, meaning out.

Vector = dict[str, Any]
VECTORS: list[Vector] = json.loads(
    (Path(__file__).parent / "vectors" / "shimmer.json").read_text(encoding="utf-8")
)["vectors"]
PASCALS = 0.5


def of_kind(kind: str) -> pytest.MarkDecorator:
    chosen = [vector for vector in VECTORS if vector["kind"] == kind]
    assert chosen
    return pytest.mark.parametrize("vector", chosen, ids=lambda vector: vector["name"])


def test_no_kind_of_vector_is_left_out() -> None:
    kinds = {"block", "stream", "air", "registers", "exg"}
    assert {vector["kind"] for vector in VECTORS} == kinds


@of_kind("block")
def test_blocks_of_the_memory(vector: Vector) -> None:
    block = Block[vector["block"]]
    memory = b"\xff" * 21 * block + bytes.fromhex(vector["hex"])
    found, expected = stored(memory, block), vector["expected"]
    if expected is None:
        assert found is None
    else:
        assert found is not None
        np.testing.assert_allclose(found.apply([expected["raw"]]), [expected["calibrated"]])


@of_kind("stream")
def test_typical_values_where_a_memory_has_none(vector: Vector) -> None:
    kind = Kind(vector["hw"], Firmware(3, (1, 1, 2)))
    layout = kind.layout(vector["channels"])
    protocol = ShimmerProtocol()
    protocol.expect_data(layout, vector["divisor"])
    found = [*protocol.feed(bytes.fromhex(vector["hex"]), 0.0), *protocol.settle()]
    values = [message.values for message, _ in found if isinstance(message, Packet)]
    assert len(values) == 2
    setup = bytes.fromhex(vector["setup"])
    present = Inquiry(vector["divisor"], setup, tuple(vector["channels"]))
    (signal,) = motion_signals(layout, typical_calibrations(kind, layout, present, None))
    (name,) = vector["expected"]
    assert signal.data_name == name
    raw = np.array(values, np.float64)[:, signal.at]
    np.testing.assert_allclose(signal.convert(raw), [vector["expected"][name]] * 2, atol=1e-9)


@of_kind("air")
def test_pressure_and_temperature(vector: Vector) -> None:
    coefficients = PressureCoefficients(vector["chip"], bytes.fromhex(vector["hex"]))
    compensate = compensation(coefficients, vector["oversampling"])
    assert compensate is not None
    raw = np.array([vector["raw_t"]], np.float64), np.array([vector["raw_p"]], np.float64)
    (pascals,), (celsius,) = compensate(*raw)
    # The example of the oldest chip is in whole numbers, of which one is 3 Pa or 0.1 degrees.
    assert pascals == pytest.approx(vector["expected"]["pa"], abs=vector["within_pa"])
    assert celsius == pytest.approx(vector["expected"]["celsius"], abs=vector["within_celsius"])


@of_kind("registers")
def test_registers_of_the_exg_chips(vector: Vector) -> None:
    expected, chip = vector["expected"], int(vector["chip"])
    use, lead_off = Use(expected["use"]), expected["lead_off"]
    wanted = registers_for(use, expected["gain"], vector["rate_hz"], lead_off=lead_off)
    assert calibration.are_same(bytes.fromhex(vector["hex"]), wanted[chip])
    assert not calibration.are_same(bytes.fromhex(vector["hex"]), wanted[1 - chip])
    set_up = Exg(wanted)
    assert set_up.use is use
    assert set_up.detects_lead_off is lead_off
    assert {set_up.gain(0, 1), set_up.gain(0, 2)} == {expected["gain"]}


@of_kind("exg")
def test_voltages(vector: Vector) -> None:
    raw = int.from_bytes(bytes.fromhex(vector["hex"]), "big", signed=True)
    (value,) = microvolts([raw], vector["gain"], vector["bits"]).tolist()
    assert value == pytest.approx(vector["expected"]["uv"], rel=1e-12)


# What a chip of the shop said; its formula in whole numbers is Bosch's other one.
BMP390 = (27738, 19081, -10, 1127, -743, 35, 0, 25286, 30515, 3, -10, 16334, 24, -60)


def in_whole_numbers(numbers: Sequence[int], raw_t: int, raw_p: int) -> tuple[float, float]:
    """Compensate as Bosch's formula for 64-bit integers does."""
    t1, t2, t3, p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11 = numbers
    d = raw_t - 256 * t1
    t = (t2 * d * 262144 + d * d * t3) // 4294967296
    square = t * t
    cube = square // 64 * t // 256
    offset = p8 * cube // 32 + p7 * square * 16 + p6 * t * 4194304 + p5 * 140737488355328
    slope = p4 * cube // 32 + p3 * square * 4
    slope += (p2 - 16384) * t * 2097152 + (p1 - 16384) * 70368744177664
    bent = raw_p * ((p10 * t + 65536 * p9) * raw_p // 8192 // 10) // 512 * 10
    whole = offset // 4 + slope // 16777216 * raw_p + bent
    whole += p11 * raw_p * raw_p // 65536 * raw_p // 128
    return whole * 25 // 1099511627776 / 100, t * 25 // 16384 / 100


@pytest.mark.parametrize("raw_p", [5_000_000, 6_500_000, 8_000_000])
@pytest.mark.parametrize("raw_t", [7_900_000, 8_300_000, 8_800_000])
def test_a_bmp390_by_both_formulas_of_its_maker(raw_t: int, raw_p: int) -> None:
    data = memory_of(BMP390)
    compensate = compensation(PressureCoefficients(PressureChip.BMP390, data), 0)
    assert compensate is not None
    (pascals,), (celsius,) = compensate(np.array([raw_t], float), np.array([raw_p], float))
    expected_pa, expected_c = in_whole_numbers(BMP390, raw_t, raw_p)
    assert pascals == pytest.approx(expected_pa, abs=PASCALS)
    assert celsius == pytest.approx(expected_c, abs=0.02)


def memory_of(numbers: Sequence[int]) -> bytes:
    widths = (2, 2, 1, 2, 2, 1, 1, 2, 2, 1, 1, 2, 1, 1)
    parts = zip(numbers, widths, strict=True)
    return b"".join((each % (1 << 8 * width)).to_bytes(width, "little") for each, width in parts)


@pytest.mark.parametrize("filling", [b"\x01", b"\x00", b"\xff"])
def test_coefficients_of_no_chip_are_none(filling: bytes) -> None:
    assert not are_real(PressureCoefficients(PressureChip.BMP180, filling * 22))


@pytest.mark.parametrize("chip", [-1, 4, PressureChip.BMP280])
def test_an_unknown_pressure_chip_has_no_compensation(chip: int) -> None:
    assert compensation(PressureCoefficients(chip, bytes(5)), 0) is None


def test_a_packet_of_all_sensors_is_as_long_as_its_channels() -> None:
    ids = [0, 1, 2, 10, 11, 12, 4, 5, 6, 7, 8, 9, 26, 27, 29, 30, 31, 32, 33, 34]
    assert Layout(ids).size == 4 * 6 + 5 + 14
    assert Layout(ids, is_3r=True).size == 4 * 6 + 6 + 14


# Framing: any bytes, any pieces, damage, and what a byte more decides.
LAYOUT = Layout([0x12, 0x1C])
MODES = list(CrcMode)
HARDWARE = bytes.fromhex("2503")
FIRMWARE = bytes.fromhex("2f03000000100b")
CARD = bytes.fromhex("6503300102")
INQUIRY = bytes.fromhex("020001029b39090201121c")
STATUS = bytes.fromhex("8a7125")
BATTERY = bytes.fromhex("8a942e0b80")
ACK, NACK = b"\xff", b"\xfe"
MEANINGS: dict[bytes, Message] = {
    ACK: Ack(),
    NACK: Nack(),
    ACK + HARDWARE: Hardware(3),
    ACK + FIRMWARE: Firmware(3, (0, 16, 11)),
    ACK + CARD: DaughterCard(bytes([48, 1, 2])),
    ACK + INQUIRY: Inquiry(256, bytes.fromhex("029b3909"), (0x12, 0x1C)),
    ACK + STATUS: Status(StatusFlag.DOCKED | StatusFlag.CLOCK_SET | StatusFlag.CARD_PRESENT),
    STATUS: Status(StatusFlag.DOCKED | StatusFlag.CLOCK_SET | StatusFlag.CARD_PRESENT),
    ACK + BATTERY: BatteryReading(2862, 0x80),
    BATTERY: BatteryReading(2862, 0x80),
}


def protocol_for(crc: CrcMode, *, streaming: bool = True) -> ShimmerProtocol:
    protocol = ShimmerProtocol()
    protocol.crc = crc
    if streaming:
        protocol.expect_data(LAYOUT, 256)
    return protocol


def packet(number: int, first: int = 0xFFF000) -> Packet:
    return Packet((first + 256 * number) % (1 << 24), (1000 + number, 0x4000 + 3 * number))


def wire(message: Packet | bytes, crc: CrcMode) -> bytes:
    if isinstance(message, Packet):
        values = b"".join(value.to_bytes(2, "little") for value in message.values)
        message = b"\0" + message.ticks.to_bytes(3, "little") + values
    return message + checksum(message, crc)


def decode(protocol: ShimmerProtocol, *pieces: bytes) -> list[Message]:
    return [message for piece in pieces for message, _ in protocol.feed(piece, 0.0)]


def pieces(data: bytes, cuts: Sequence[int]) -> list[bytes]:
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[a:b] for a, b in pairwise(edges)]


@pytest.mark.parametrize("crc", MODES)
@pytest.mark.parametrize("data", MEANINGS)
def test_every_message_alone(data: bytes, crc: CrcMode) -> None:
    protocol = protocol_for(crc, streaming=False)
    sent = wire(data, crc)
    found = decode(protocol, *(bytes([byte]) for byte in sent))
    found += [message for message, _ in protocol.settle()]
    assert found == [MEANINGS[data]]
    assert protocol.dropped_bytes == 0
    assert not protocol.undecided


@pytest.mark.parametrize("crc", MODES)
@given(
    order=st.lists(st.sampled_from([None, *MEANINGS]), max_size=30),
    cuts=st.lists(st.integers(0, 500), max_size=12),
)
def test_a_sound_stream_is_decoded_in_pieces_of_any_size(
    crc: CrcMode, order: list[bytes | None], cuts: list[int]
) -> None:
    # Two packets first and last: without full checksums they vouch for each other.
    kinds: list[bytes | None] = [None, None, *order, None, None]
    if crc is CrcMode.OFF:
        # Firmware without checksums puts an ACK before them, always.
        kinds = [kind for kind in kinds if kind not in {STATUS, BATTERY}]
    expected: list[Message] = []
    data, number = b"", 0
    for kind in kinds:
        data += wire(packet(number) if kind is None else kind, crc)
        expected.append(packet(number) if kind is None else MEANINGS[kind])
        number += kind is None
    protocol = protocol_for(crc)
    found = decode(protocol, *pieces(data, cuts))
    found += [message for message, _ in protocol.settle()]
    assert found == expected
    assert protocol.dropped_bytes == 0


SOUND = b"".join(wire(packet(k), CrcMode.FULL) for k in range(6))
noise = st.one_of(
    st.binary(max_size=300),
    st.lists(
        st.sampled_from([b"\0", ACK, NACK, b"\x8a", b"\x02", b"\x65", SOUND, INQUIRY, HARDWARE]),
        max_size=60,
    ).map(b"".join),
)


@pytest.mark.parametrize("crc", MODES)
@given(
    data=noise,
    cuts=st.lists(st.integers(0, 10_000), max_size=20),
    setup_bytes=st.sampled_from([4, 7]),
    streaming=st.booleans(),
)
@example(data=b"\xff\x02" + bytes(100), cuts=[], setup_bytes=4, streaming=True)
@settings(max_examples=300)
def test_any_bytes_in_any_pieces_give_the_same(
    crc: CrcMode, data: bytes, cuts: list[int], setup_bytes: int, streaming: bool
) -> None:
    whole, parts = (protocol_for(crc, streaming=streaming) for _ in range(2))
    whole.form = parts.form = ReplyForm(setup_bytes)
    assert decode(whole, data) == decode(parts, *pieces(data, cuts))
    assert whole.settle() == parts.settle()
    assert whole.give_up() == parts.give_up()
    assert whole.dropped_bytes == parts.dropped_bytes
    assert not whole.undecided


@pytest.mark.parametrize("crc", MODES)
@pytest.mark.parametrize("byte", [0x00, 0x02, 0x65, 0x8A, 0xFE, 0xFF])
def test_memory_is_bounded_whatever_comes(crc: CrcMode, byte: int) -> None:
    protocol = protocol_for(crc)
    for data in (bytes([byte]) * 100_000, b"\xff\x02" * 50_000, b"\xff\x65\x10" * 30_000):
        decode(protocol, data)
        assert protocol.buffered < 200


@pytest.mark.parametrize("crc", MODES)
def test_a_message_has_the_arrival_of_its_last_byte(crc: CrcMode) -> None:
    protocol = protocol_for(crc)
    data = b"".join(wire(packet(k), crc) for k in range(20))
    size = len(data) // 20
    found = [each for at, byte in enumerate(data) for each in protocol.feed(bytes([byte]), at)]
    found += protocol.settle()
    assert [arrival_s for _, arrival_s in found] == [size * (k + 1) - 1 for k in range(20)]


def stream(crc: CrcMode) -> list[bytes]:
    battery, status = wire(ACK + BATTERY, crc), wire(STATUS, crc)
    packets = [wire(packet(k, first=0x00FE00), crc) for k in range(40)]
    return [*packets[:13], battery, *packets[13:27], status, *packets[27:]]


def check_damaged(damaged: bytes, most_lost: int) -> int:
    protocol = protocol_for(CrcMode.FULL)
    found = decode(protocol, damaged) + [message for message, _ in protocol.give_up()]
    values = [message for message in found if isinstance(message, Packet)]
    sound = [packet(k, first=0x00FE00) for k in range(40)]
    kept = [each for each in sound if each in values]
    assert values == kept, "a wrong value, a doubled one, or another order"
    assert len(values) >= len(sound) - most_lost
    assert set(found) - set(values) <= {MEANINGS[STATUS], MEANINGS[BATTERY]}
    return len(sound) - len(values)


def test_a_single_byte_flipped_never_makes_a_wrong_value() -> None:
    data = b"".join(stream(CrcMode.FULL))
    lost = 0
    for at in range(len(data)):
        for flip in (0x01, 0x80, 0xFF, data[at], data[at] ^ 0xFF):
            if flip:
                lost += check_damaged(data[:at] + bytes([data[at] ^ flip]) + data[at + 1 :], 1)
    assert lost > 0


def test_a_single_byte_removed_or_doubled_never_makes_a_wrong_value() -> None:
    data = b"".join(stream(CrcMode.FULL))
    for at in range(len(data)):
        check_damaged(data[:at] + data[at + 1 :], 1)
        check_damaged(data[:at] + data[at : at + 1] + data[at:], 1)


@given(at=st.integers(0, 400), garbage=st.binary(min_size=1, max_size=60))
def test_garbage_between_messages_costs_nothing_with_full_checksums(
    at: int, garbage: bytes
) -> None:
    messages = stream(CrcMode.FULL)
    at %= len(messages)
    check_damaged(b"".join(messages[:at]) + garbage + b"".join(messages[at:]), 0)


def test_without_checksums_a_lost_byte_costs_a_packet_or_two_and_no_wrong_value() -> None:
    # A low byte of the stamp that is no head: else a packet may end one byte late unseen.
    sent = [packet(k, first=0x123437) for k in range(30)]
    data = b"".join(wire(each, CrcMode.OFF) for each in sent)
    for at in range(8 * 5, 8 * 25):
        protocol = protocol_for(CrcMode.OFF)
        damaged = decode(protocol, data[:at] + data[at + 1 :])
        found = [message for message in damaged if isinstance(message, Packet)]
        assert [each for each in found if each not in sent] == []
        assert len(found) >= len(sent) - 4


@pytest.mark.parametrize("crc", [CrcMode.OFF, CrcMode.LOW_BYTE])
def test_a_jump_of_the_counter_is_believed_with_its_successor(crc: CrcMode) -> None:
    protocol = protocol_for(crc)
    before = [packet(k) for k in range(3)]
    after = [packet(k, first=0x400000) for k in range(3)]
    alone = packet(0, first=0x900000)
    sent = [*before, alone, *after]
    found = decode(protocol, *(wire(each, crc) for each in sent))
    found += [message for message, _ in protocol.settle()]
    assert found == [*before, *after]
    assert protocol.dropped_bytes == len(wire(alone, crc))


def test_with_full_checksums_a_jump_is_believed_at_once() -> None:
    protocol = protocol_for(CrcMode.FULL)
    sent = [packet(0), packet(0, first=0x400000)]
    assert decode(protocol, *(wire(each, CrcMode.FULL) for each in sent)) == sent


def test_an_unasked_status_of_older_firmware_is_no_acknowledgement() -> None:
    protocol = protocol_for(CrcMode.OFF, streaming=False)
    assert decode(protocol, ACK) == []
    assert protocol.undecided
    assert decode(protocol, STATUS) == [MEANINGS[STATUS]]
    assert decode(protocol, ACK + ACK + STATUS) == [Ack(), MEANINGS[STATUS]]
    assert protocol.dropped_bytes == 0


def test_a_bare_acknowledgement_is_one_after_a_moment() -> None:
    protocol = protocol_for(CrcMode.OFF, streaming=False)
    assert decode(protocol, ACK) == []
    assert [message for message, _ in protocol.settle()] == [Ack()]


@pytest.mark.parametrize("crc", [CrcMode.LOW_BYTE, CrcMode.FULL])
def test_with_checksums_an_acknowledgement_needs_no_moment(crc: CrcMode) -> None:
    protocol = protocol_for(crc, streaming=False)
    assert decode(protocol, wire(ACK, crc)) == [Ack()]


def test_the_answers_of_a_shimmer3r() -> None:
    protocol = protocol_for(CrcMode.FULL, streaming=False)
    protocol.form = ReplyForm(setup_bytes=7, status_bytes=2)
    inquiry = bytes.fromhex("028002000000090000000201121c")
    status = bytes.fromhex("8a711001")
    found = decode(protocol, *(wire(ACK + each, CrcMode.FULL) for each in (inquiry, status)))
    assert found == [
        Inquiry(640, bytes.fromhex("00000009000000"), (0x12, 0x1C)),
        Status(StatusFlag.STREAMING),
    ]


def test_a_torn_answer_hides_nothing_once_it_is_given_up() -> None:
    protocol = protocol_for(CrcMode.FULL, streaming=False)
    torn = wire(ACK + FIRMWARE, CrcMode.FULL)[:4]
    assert decode(protocol, torn + wire(ACK, CrcMode.FULL)) == []
    assert [message for message, _ in protocol.give_up()] == [Ack()]
    assert protocol.dropped_bytes == len(torn)


def test_a_layout_of_unknown_channels_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown width"):
        Layout([0x12, 0x77])
    assert Layout([0x1C, 0x12]).read(bytes.fromhex("01400203")) == (0x4001, 0x0302)
