"""Messages and payloads, against vectors and against any bytes."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_common.refusal import Refusal
from biosensor_gateway.devices.movesense.driver import protocol
from biosensor_gateway.devices.movesense.driver.emitter import (
    MovesenseEmitter,
    PacketSeries,
    StampClock,
)
from biosensor_gateway.devices.movesense.driver.protocol import (
    TEMPERATURE,
    Assembler,
    Kind,
    Message,
    Packet,
    ecg,
    parse_ecg,
    parse_heart_rate,
    parse_message,
    parse_temperature,
    parse_vectors,
)
from tests.rigs.emitter_sink import EmitterSink

VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors/movesense_gsp.json").read_text(encoding="utf-8")
)


def of_kind(*kinds: str) -> pytest.MarkDecorator:
    found = [vector for vector in VECTORS if vector["kind"] in kinds]
    assert found
    return pytest.mark.parametrize("vector", found, ids=[vector["name"] for vector in found])


def message(vector: dict[str, Any]) -> Message:
    found = parse_message(bytes.fromhex(vector["hex"]))
    assert found is not None
    return found


@of_kind("ecg")
def test_ecg_is_in_microvolts_whatever_came(vector: dict[str, Any]) -> None:
    block = parse_ecg(message(vector).payload, vector["width"])
    expected = vector["expected"]
    if expected is None:
        assert block is None
        return
    assert block is not None
    assert block.stamp_ms == expected["stamp_ms"]
    assert block.samples.shape == (1, len(expected["microvolts"]), 1)
    np.testing.assert_allclose(block.samples.ravel(), expected["microvolts"], rtol=1e-9)


@of_kind("vectors")
def test_vectors_stand_array_behind_array(vector: dict[str, Any]) -> None:
    block = parse_vectors(message(vector).payload, vector["streams"])
    expected = vector["expected"]
    if expected is None:
        assert block is None
        return
    assert block is not None
    assert block.stamp_ms == expected["stamp_ms"]
    np.testing.assert_allclose(block.samples, expected["streams"], rtol=1e-6)


@of_kind("heart_rate")
def test_a_heart_rate_has_its_intervals(vector: dict[str, Any]) -> None:
    measured = parse_heart_rate(message(vector).payload)
    expected = vector["expected"]
    found = measured and {"bpm": measured.bpm, "intervals_ms": list(measured.intervals_ms)}
    assert found == expected


@of_kind("temperature")
def test_a_temperature_is_in_degrees_celsius(vector: dict[str, Any]) -> None:
    measured = parse_temperature(message(vector).payload)
    if vector["expected"] is None:
        assert measured is None
    else:
        expected = vector["expected"]["stamp_ms"], pytest.approx(vector["expected"]["celsius"])
        assert measured == expected


@of_kind("greeting")
def test_a_greeting_says_who_it_is(vector: dict[str, Any]) -> None:
    greeting = protocol.parse_greeting(message(vector).payload)
    assert greeting._asdict() == vector["expected"]
    assert not protocol.is_refused_greeting(message(vector).payload)


@of_kind("answer")
def test_an_answer_says_whether_it_is_a_refusal(vector: dict[str, Any]) -> None:
    found = message(vector)
    assert {"status": found.status, "is_refusal": found.is_refusal} == vector["expected"]


@of_kind("part")
def test_a_part_goes_with_a_reference(vector: dict[str, Any]) -> None:
    found = message(vector)
    assert found.kind is Kind.DATA_PART_2
    assert {"reference": found.reference, "payload": found.payload.hex()} == vector["expected"]


@of_kind("nothing")
def test_anything_else_is_no_message(vector: dict[str, Any]) -> None:
    assert parse_message(bytes.fromhex(vector["hex"])) is None


def test_a_greeting_that_is_refused_is_told_from_one_that_is_not() -> None:
    assert protocol.is_refused_greeting(struct.pack("<H", 429))
    assert not protocol.is_refused_greeting(struct.pack("<H", 200))


def test_commands_are_written_as_documented() -> None:
    assert protocol.hello(1) == b"\x00\x01"
    assert protocol.subscribe(100, "/Meas/ECG/200") == b"\x01\x64/Meas/ECG/200"
    assert protocol.unsubscribe(100) == b"\x02\x64"


@given(st.binary(max_size=200), st.sampled_from([2, 4]), st.integers(1, 3))
def test_any_bytes_are_read_whole_or_not_at_all(data: bytes, width: int, streams: int) -> None:
    ecg, vectors = parse_ecg(data, width), parse_vectors(data, streams)
    if ecg is not None:
        assert ecg.samples.size in {(len(data) - 4) / each for each in (2, 4)}
    if vectors is not None:
        assert vectors.samples.size * 4 == len(data) - 4
        assert np.isfinite(vectors.samples).all()
    measured = parse_heart_rate(data)
    assert measured is None or len(measured.intervals_ms) * 2 == len(data) - 4
    protocol.parse_greeting(data)


# Packets in parts are put together, and their samples placed on the device's clock.

# Samples on the device's clock: evenly spaced whatever stamps say, and what is missing counted.


def stamp(index: int, rate_hz: float) -> float:
    """As a device writes it: in whole milliseconds."""
    return round(1000 * index / rate_hz) / 1000


@pytest.mark.parametrize(
    ("nominal_hz", "deviation", "count"),
    [(200, 0.0, 16), (512, -0.001, 16), (52, 0.02, 4), (104, -0.05, 8), (13, 0.05, 1)],
)
def test_samples_are_as_even_as_they_were_measured(
    nominal_hz: int, deviation: float, count: int
) -> None:
    rate_hz = nominal_hz * (1 + deviation)
    series = PacketSeries(nominal_hz)
    times: list[float] = []
    for first in range(0, int(20 * rate_hz), count):
        placed = series.place(stamp(first, rate_hz), count)
        assert placed.lost == 0
        times += placed.times_s
    errors = np.array(times) - np.arange(len(times)) / rate_hz
    settled = errors[len(errors) // 4 :]
    assert np.abs(settled).max() < 1e-3
    assert np.sqrt(np.mean(np.diff(settled) ** 2)) < 0.2e-3


@given(st.integers(1, 200), st.sampled_from([(200, 16), (52, 4), (13, 1)]))
def test_lost_packets_are_counted_exactly(missing: int, kind: tuple[int, int]) -> None:
    nominal_hz, count = kind
    rate_hz = nominal_hz * 1.02
    series = PacketSeries(nominal_hz)
    for number in range(50):
        series.place(stamp(number * count, rate_hz), count)
    placed = series.place(stamp((50 + missing) * count, rate_hz), count)
    # Of long gaps, what the rate is known to; it has been followed for some seconds.
    assert placed.lost == pytest.approx(missing * count, rel=0.005, abs=0)
    assert placed.lost % count == 0


def test_a_new_series_begins_at_its_stamp_and_bridges_the_gap() -> None:
    series = PacketSeries(200)
    for number in range(20):
        series.place(stamp(number * 16, 200), 16)
    series.restart()
    placed = series.place(20 * 16 / 200 + 1.0004, 16)
    assert placed.times_s[0] == 20 * 16 / 200 + 1.0004
    assert placed.lost == 200
    assert PacketSeries(200).place(1e6, 16).lost == 0


def test_stamps_that_step_back_are_followed() -> None:
    series = PacketSeries(200)
    series.place(1000.0, 16)
    placed = series.place(10.0, 16)
    assert (placed.times_s[0], placed.lost) == (10.0, 0)
    assert series.place(10.08, 16).times_s[0] == pytest.approx(10.08)


def test_a_series_that_is_made_again_knows_nothing() -> None:
    series = PacketSeries(200)
    series.place(1000.0, 16)
    assert series.restarted().place(2000.0, 16).lost == 0


def test_stamps_roll_over_after_seven_weeks() -> None:
    clock = StampClock()
    assert clock.read(2**32 - 10) == pytest.approx((2**32 - 10) / 1000)
    # Of another measurement, a little older.
    assert clock.read(2**32 - 30) == pytest.approx((2**32 - 30) / 1000)
    assert clock.read(70) == pytest.approx((2**32 + 70) / 1000)
    assert clock.read(2**32 - 5) == pytest.approx((2**32 - 5) / 1000)
    clock.forget()
    assert clock.read(70) == pytest.approx(0.07)


# Packets that came in parts.
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


def test_a_packet_that_comes_twice_is_left_out_and_said() -> None:
    sink = EmitterSink("movesense")
    emitter, wanted = MovesenseEmitter(sink, ()), ecg(200, in_millivolts=False)
    emitter.started(wanted)
    packets = [struct.pack("<I16i", 1000 + 80 * at, *range(16)) for at in range(4)]
    for at, payload in enumerate([*packets, packets[2], packets[3]]):
        emitter.take(wanted, Packet(payload, 10 + 0.08 * at))
    assert len(sink.values("ecg")) == 4 * 16
    warm = struct.pack("<If", 2000, 300.0)
    for _ in range(2):
        emitter.take(TEMPERATURE, Packet(warm, 11.0))
    assert len(sink.values("temp")) == 1
    assert sink.refusals.count(Refusal.LEFT_OUT) == 2 * 16 + 1
