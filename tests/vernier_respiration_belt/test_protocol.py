"""Packets of the belt, against captured and generated vectors and any other bytes."""

from __future__ import annotations

import json
import math
from collections.abc import Generator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from biosensor_gateway.devices.vernier_respiration_belt.driver import protocol
from biosensor_gateway.devices.vernier_respiration_belt.driver.protocol import (
    Head,
    Measurement,
    MeasurementKind,
    Message,
    Notice,
    PacketParser,
    Reply,
    Unknown,
    VernierProtocol,
    encode,
    fragments,
)
from biosensor_gateway.devices.vernier_respiration_belt.simulator.wire import BeltFirmware
from biosensor_gateway.simulation.bleak_backend import virtual_bluetooth
from biosensor_gateway.simulation.radio import Radio
from biosensor_gateway.simulation.world import World


class _Vector(NamedTuple):
    data: bytes
    fragments: list[bytes]
    expected: dict[str, Any]


def _load() -> dict[str, _Vector]:
    path = Path(__file__).parent / "vectors" / "vernier_gdxrb.json"
    entries: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    return {
        entry["name"]: _Vector(
            bytes.fromhex(entry["hex"]),
            [bytes.fromhex(fragment) for fragment in entry["fragments"]],
            entry["expected"],
        )
        for entry in entries
    }


_VECTORS = _load()
_COMMANDS = [name for name, vector in _VECTORS.items() if vector.data[0] == Head.COMMAND]
_REPLIES = [name for name, vector in _VECTORS.items() if vector.data[0] == Head.REPLY]
_MEASUREMENTS = [name for name, vector in _VECTORS.items() if vector.data[0] == Head.MEASUREMENT]
_STREAM = b"".join(_VECTORS[name].data for name in [*_REPLIES, *_MEASUREMENTS])
_REAL = _VECTORS["real_meas_two_samples_force_nan"].data

_BODIES = {
    "conv_00_cmd_init": protocol.INIT,
    "conv_02_cmd_get_status": protocol.GET_STATUS,
    "conv_04_cmd_get_device_info": protocol.DEVICE_INFO,
    "conv_06_cmd_get_available_mask": protocol.AVAILABLE_CHANNELS,
    # Not needed, so the driver has no name for it.
    "conv_08_cmd_get_default_mask": bytes((0x56,)),
    "conv_10_cmd_get_sensor_info_1": protocol.sensor_info(1),
    "conv_12_cmd_get_sensor_info_2": protocol.sensor_info(2),
    "conv_14_cmd_get_sensor_info_4": protocol.sensor_info(4),
    "conv_16_cmd_get_sensor_info_5": protocol.sensor_info(5),
    "conv_18_cmd_set_period_100ms": protocol.set_period(100_000),
    "conv_20_cmd_start_force_and_rate": protocol.start(0b110),
    "conv_22_cmd_stop_all": protocol.STOP,
    "conv_24_cmd_disconnect": protocol.DISCONNECT,
}


def decoded(*pieces: bytes) -> list[Message]:
    belt = VernierProtocol()
    return [message for piece in pieces for message in belt.feed(piece)]


def comparable(messages: Sequence[Message]) -> list[str]:
    """NaN is not equal to itself, but looks the same."""
    return [repr(message) for message in messages]


def cut(data: bytes, places: Sequence[int]) -> list[bytes]:
    edges = [0, *sorted(place % (len(data) + 1) for place in places), len(data)]
    return [data[start:end] for start, end in pairwise(edges)]


def packet(head: Head, body: bytes) -> bytes:
    data = bytearray((head, 4 + len(body), 7, 0)) + body
    data[3] = sum(data) & 0xFF
    return bytes(data)


def expected_samples(rows: list[dict[str, float | None]]) -> dict[int, list[float]]:
    channels = rows[0] if rows else {}
    return {
        int(channel): [
            math.nan if row[channel] is None else float(row[channel] or 0) for row in rows
        ]
        for channel in channels
    }


def test_every_vector_is_used() -> None:
    assert {*_COMMANDS, *_REPLIES, *_MEASUREMENTS} == _VECTORS.keys()
    assert set(_COMMANDS) == _BODIES.keys()


@pytest.mark.parametrize("name", _COMMANDS)
def test_commands_are_encoded_and_cut(name: str) -> None:
    vector = _VECTORS[name]
    assert encode(vector.expected["counter"], _BODIES[name]) == vector.data
    assert fragments(vector.data) == vector.fragments


@pytest.mark.parametrize("name", _REPLIES)
def test_replies_are_reassembled(name: str) -> None:
    vector = _VECTORS[name]
    (reply,) = decoded(*vector.fragments)
    assert isinstance(reply, Reply)
    assert reply.counter == vector.expected["counter"]
    assert reply.command == vector.expected["command"]
    assert reply.echo == vector.expected["echoed_counter"]
    assert reply.payload == vector.data[6:]


@pytest.mark.parametrize("name", [name for name in _MEASUREMENTS if "ignore" not in name])
def test_measurements_hold_the_samples(name: str) -> None:
    vector = _VECTORS[name]
    (measured,) = decoded(*vector.fragments)
    assert isinstance(measured, Measurement)
    assert measured.counter == vector.expected["counter"]
    assert measured.kind == vector.expected["meas_type"]
    expected = expected_samples(vector.expected["samples"])
    assert measured.samples.keys() == expected.keys()
    for channel, values in expected.items():
        assert measured.samples[channel] == pytest.approx(values, abs=1e-6, nan_ok=True)


@pytest.mark.parametrize("name", [name for name in _MEASUREMENTS if "ignore" in name])
def test_notices_have_no_samples(name: str) -> None:
    vector = _VECTORS[name]
    (notice,) = decoded(vector.data)
    kind = MeasurementKind(vector.expected["meas_type"])
    assert notice == Notice(vector.expected["counter"], kind)


def test_status() -> None:
    vector = _VECTORS["conv_03_rsp_get_status"]
    assert protocol.parse_status(vector.data[6:]) == protocol.Status(
        vector.expected["main_fw"],
        vector.expected["ble_fw"],
        vector.expected["battery_percent"],
        vector.expected["charger_state"],
    )


def test_device_info() -> None:
    vector = _VECTORS["conv_05_rsp_get_device_info"]
    assert protocol.parse_device_info(vector.data[6:]) == protocol.Identity(
        vector.expected["order_code"],
        vector.expected["serial"],
        vector.expected["name"],
        vector.expected["main_fw"],
        vector.expected["description"],
    )


def test_masks() -> None:
    for name in ("conv_07_rsp_get_available_mask", "conv_09_rsp_get_default_mask"):
        vector = _VECTORS[name]
        mask = protocol.parse_mask(vector.data[6:])
        assert mask is not None
        assert mask == vector.expected["mask"]
        assert protocol.channels_of(mask) == vector.expected["channels"]


@pytest.mark.parametrize("number", [1, 2, 4, 5])
def test_channels(number: int) -> None:
    (vector,) = (v for n, v in _VECTORS.items() if n.endswith(f"rsp_get_sensor_info_{number}"))
    names = ("number", "description", "unit", "min_period_us", "max_period_us", "granularity_us")
    expected = protocol.Channel(*(vector.expected[name] for name in names))
    assert protocol.parse_channel(vector.data[6:]) == expected


def test_a_channel_without_a_sensor_is_none() -> None:
    payload = bytearray(_VECTORS["conv_11_rsp_get_sensor_info_1"].data[6:])
    payload[2:6] = bytes(4)
    assert protocol.parse_channel(bytes(payload)) is None


@given(st.binary(max_size=200))
def test_payloads_of_any_length_are_read_or_refused(payload: bytes) -> None:
    for parse in (protocol.parse_status, protocol.parse_device_info, protocol.parse_channel):
        parse(payload)
    assert (protocol.parse_mask(payload) is None) == (len(payload) < 4)


def test_refusals_are_told_from_warnings() -> None:
    status = _VECTORS["rsp_error_command_not_recognised"].data[6]
    assert status & protocol.REFUSED
    assert not 0xCC & protocol.REFUSED


@given(st.lists(st.integers(0, 10_000), max_size=40))
def test_every_chunking_gives_the_same(places: list[int]) -> None:
    whole = decoded(_STREAM)
    assert len(whole) == len(_REPLIES) + len(_MEASUREMENTS)
    assert comparable(decoded(*cut(_STREAM, places))) == comparable(whole)


@given(st.lists(st.one_of(st.binary(max_size=40), st.sampled_from([_REAL, b"\x20", b"\x98\xff"]))))
def test_any_bytes_are_packets_or_dropped_or_waiting(pieces: list[bytes]) -> None:
    parser = PacketParser()
    packets = [packet for piece in pieces for packet in parser.feed(piece)]
    assert parser.buffered < 255
    size = sum(len(packet.data) for packet in packets)
    assert size + parser.dropped_bytes + parser.buffered == sum(map(len, pieces))
    again = PacketParser()
    assert again.feed(b"".join(pieces)) == packets
    assert again.dropped_bytes == parser.dropped_bytes


@given(st.lists(st.binary(max_size=60)))
def test_no_bytes_make_it_raise(pieces: list[bytes]) -> None:
    belt = VernierProtocol()
    for piece in pieces:
        belt.feed(piece)
        belt.feed(_wrapped(piece))
    belt.give_up()
    assert belt.buffered == 0


def _wrapped(body: bytes) -> bytes:
    """Bytes that pass as a measurement as far as the checksum goes."""
    return packet(Head.MEASUREMENT, body)


@given(st.integers(4, len(_REAL) - 1), st.integers(1, 255))
def test_a_damaged_packet_is_dropped_and_the_next_one_read(at: int, change: int) -> None:
    damaged = bytearray(_REAL)
    damaged[at] ^= change
    belt = VernierProtocol()
    messages = belt.feed(bytes(damaged) + _REAL + _REAL)
    # A damaged byte that looks like the head of a long packet hides what follows it.
    messages += belt.give_up()
    assert comparable(messages) == comparable(decoded(_REAL, _REAL))


@pytest.mark.parametrize("name", ["conv_05_rsp_get_device_info", "meas_normal_4ch_2samples"])
def test_a_lost_fragment_costs_its_packet_only(name: str) -> None:
    pieces = _VECTORS[name].fragments
    for missing in range(len(pieces)):
        rest = [piece for index, piece in enumerate(pieces) if index != missing]
        belt = VernierProtocol()
        messages = [message for piece in rest for message in belt.feed(piece)]
        messages += belt.feed(_REAL * 11)
        assert comparable(messages) == comparable(decoded(_REAL * 11))
        assert belt.dropped_bytes == sum(map(len, rest))


def test_giving_up_finds_what_a_false_start_hid() -> None:
    belt = VernierProtocol()
    assert belt.feed(b"\x20\xff" + _REAL) == []
    assert comparable(belt.give_up()) == comparable(decoded(_REAL))
    assert (belt.dropped_bytes, belt.buffered) == (2, 0)
    # Nothing follows this one.
    assert belt.feed(b"\x20") == belt.give_up() == []
    assert (belt.dropped_bytes, belt.buffered) == (3, 0)


@pytest.mark.parametrize(
    "data",
    [
        packet(Head.REPLY, b"\x10"),
        packet(Head.MEASUREMENT, b"\x05"),
        packet(Head.MEASUREMENT, b"\x06\x06\x00"),
        packet(Head.MEASUREMENT, b"\x06\x06\x00\x02\x00" + bytes(8)),
        packet(Head.MEASUREMENT, b"\x06\x06\x00\x01\x00" + bytes(9)),
        packet(Head.MEASUREMENT, b"\x08\x00\x01\xff"),
    ],
)
def test_what_cannot_be_decoded_is_counted(data: bytes) -> None:
    belt = VernierProtocol()
    assert belt.feed(data) == [Unknown(7)]
    assert belt.dropped_bytes == len(data)
    assert comparable(belt.feed(_REAL)) == comparable(decoded(_REAL))


def test_the_count_is_unsigned() -> None:
    # 60 samples of one channel: more than a signed count of a short packet would give.
    (measured,) = decoded(packet(Head.MEASUREMENT, b"\x08\x00\x01\x3c" + bytes(240)))
    assert isinstance(measured, Measurement)
    assert measured.samples == {1: (0.0,) * 60}


@pytest.mark.parametrize(("counter", "body"), [(256, b""), (-1, b""), (0, bytes(252))])
def test_what_does_not_fit_into_a_byte_is_refused(counter: int, body: bytes) -> None:
    with pytest.raises(ValueError, match="byte"):
        encode(counter, body)


# The virtual belt: its firmware against the vectors, and on the air against plain bleak.

VECTORS: list[dict[str, Any]] = json.loads(
    (Path(__file__).parent / "vectors/vernier_gdxrb.json").read_text(encoding="utf-8")
)
CONVERSATION = [vector for vector in VECTORS if vector["name"].startswith("conv_")]
# Whatever the vendor's numbers are, the notes call these placeholders.
_PLACEHOLDERS = ("get_sensor_info", "get_device_info")


def test_the_firmware_answers_as_in_the_worked_conversation() -> None:
    firmware = BeltFirmware("GDX-RB", "0K2002Z5")
    answers: list[bytes] = []
    for vector in CONVERSATION:
        data = bytes.fromhex(vector["hex"])
        if "_cmd_" in vector["name"]:
            answers = firmware.hear(data)
        elif "_rsp_" in vector["name"]:
            (answer,) = answers
            if any(each in vector["name"] for each in _PLACEHOLDERS):
                assert answer[:6] == data[:6].replace(data[3:4], answer[3:4], 1)
                assert len(answer) == len(data)
            else:
                assert answer == data, vector["name"]
        else:
            assert firmware.pack(np.array([[11.5, np.nan]], np.float32)) == data


@pytest.fixture
def radio(virtual_world: World) -> Generator[Radio]:
    air = Radio(virtual_world)
    with virtual_bluetooth(air):
        yield air
