"""Packets that came in parts."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from biosensor_gateway.devices.movesense.driver.protocol import Assembler, Kind, Message, Packet

FULL, SAMPLE = 4 + 8 * 36, 36


def packet(number: int, length: int = FULL) -> bytes:
    return bytes([number]) * length


def parts(payload: bytes, room: int) -> list[Message]:
    kinds = (Kind.DATA, Kind.DATA_PART_2, Kind.DATA_PART_3, Kind.DATA_PART_3)
    pieces = [payload[at : at + room] for at in range(0, len(payload), room)]
    return [Message(kind, 99, piece) for kind, piece in zip(kinds, pieces, strict=False)]


def assembled(assembler: Assembler, messages: Sequence[Message]) -> list[Packet]:
    return [
        each for at, message in enumerate(messages) for each in assembler.take(message, float(at))
    ]


@pytest.mark.parametrize("room", [100, 156, 242, FULL])
def test_parts_make_packets_at_the_time_of_the_last_one(room: int) -> None:
    assembler = Assembler(FULL, SAMPLE)
    first, second = parts(packet(1), room), parts(packet(2), room)
    found = assembled(assembler, first + second)
    assert found == [
        Packet(packet(1), len(first) - 1.0),
        Packet(packet(2), len(first) + len(second) - 1.0),
    ]
    assert assembler.dropped_bytes == 0


def test_what_has_no_parts_is_complete_as_it_comes() -> None:
    assembler = Assembler(0, 1)
    assert assembled(assembler, [Message(Kind.DATA, 98, b"123456")]) == [Packet(b"123456", 0.0)]


def test_a_part_that_is_missing_costs_its_packet_alone() -> None:
    assembler = Assembler(FULL, SAMPLE)
    first, second, third = (parts(packet(number), 156) for number in (1, 2, 3))
    found = assembled(assembler, [*first, second[0], *third])
    assert [each.payload for each in found] == [packet(1), packet(3)]
    assert assembler.dropped_bytes == 156


def test_a_first_part_that_is_missing_costs_its_packet_alone() -> None:
    assembler = Assembler(FULL, SAMPLE)
    first, second = (parts(packet(number), 156) for number in (1, 2))
    found = assembled(assembler, [first[1], *second])
    assert [each.payload for each in found] == [packet(2)]
    assert assembler.dropped_bytes == FULL - 156


def test_packets_of_another_length_are_learned() -> None:
    other = 4 + 5 * SAMPLE
    assembler = Assembler(FULL, SAMPLE)
    messages = [part for number in range(1, 5) for part in parts(packet(number, other), 100)]
    found = assembled(assembler, messages)
    assert [each.payload for each in found] == [packet(number, other) for number in range(1, 5)]
    assert assembler.dropped_bytes == 0


def test_what_can_be_no_packet_is_none() -> None:
    assembler = Assembler(FULL, SAMPLE)
    cut = [Message(Kind.DATA, 99, packet(number, 17)) for number in range(4)]
    assert not assembled(assembler, cut)
    assert assembler.dropped_bytes == 3 * 17
