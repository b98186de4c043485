"""Every vector of the notes: bytes in, meaning out."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from biosensor_gateway.devices.shimmer.driver import commands
from biosensor_gateway.devices.shimmer.driver.calibration import millivolts
from biosensor_gateway.devices.shimmer.driver.channels import Channel, Layout
from biosensor_gateway.devices.shimmer.driver.commands import TICKS_PER_S, CrcMode, crc16
from biosensor_gateway.devices.shimmer.driver.messages import (
    BatteryReading,
    Charging,
    ExpansionPower,
    GsrRange,
    Inquiry,
    Message,
    Nack,
    Packet,
    ReplyForm,
    decode_reply,
)
from biosensor_gateway.devices.shimmer.driver.packets import (
    TickTimeline,
    battery_volts,
    charge_percent,
    percent,
)
from biosensor_gateway.devices.shimmer.driver.protocol import ShimmerProtocol
from biosensor_gateway.devices.shimmer3_gsr.driver.emitter import (
    LARGEST_OPEN_ADC,
    clamped_kohm,
    conductance_us,
    gsr_ranges,
)

Vector = dict[str, Any]
VECTORS: list[Vector] = json.loads(
    (Path(__file__).parent / "vectors" / "shimmer3.json").read_text(encoding="utf-8")
)["vectors"]

COMMANDS = {
    "cmd_set_gsr_range_auto": commands.set_gsr_range(4),
    "cmd_set_gsr_range_0": commands.set_gsr_range(0),
    "cmd_get_gsr_range": commands.GET_GSR_RANGE,
    "cmd_get_exp_power": commands.GET_EXPANSION_POWER,
    "cmd_crc_off": commands.set_crc(CrcMode.OFF),
    "cmd_crc_1": commands.set_crc(CrcMode.LOW_BYTE),
    "cmd_crc_2": commands.set_crc(CrcMode.FULL),
    "cmd_get_daughter_id": commands.GET_DAUGHTER_CARD,
}
EXG_NAMES = (
    "exg1_status", "exg1_ch1_24", "exg1_ch2_24", "exg2_status", "exg2_ch1_24", "exg2_ch2_24"
)  # fmt: skip
NAMES = {
    0x00: "accel_ln_x",
    0x01: "accel_ln_y",
    0x02: "accel_ln_z",
    0x03: "vbatt",
    0x12: "int_adc_a13",
    0x1C: "gsr_raw",
    **dict(zip(range(0x1D, 0x23), EXG_NAMES, strict=True)),
}


def of_kind(*kinds: str) -> pytest.MarkDecorator:
    chosen = [vector for vector in VECTORS if vector["kind"] in kinds]
    assert chosen
    return pytest.mark.parametrize("vector", chosen, ids=lambda vector: vector["name"])


def decoded(vector: Vector, data: bytes) -> list[Message]:
    protocol = ShimmerProtocol()
    protocol.crc = CrcMode(vector["crc"])
    if vector.get("hw") == 10:
        protocol.form = ReplyForm(setup_bytes=7)
    if "channels" in vector:
        protocol.expect_data(Layout(vector["channels"]), 256)
    found = [*protocol.feed(data, 0.0), *protocol.settle()]
    assert protocol.dropped_bytes == 0
    return [message for message, _ in found]


def test_no_kind_of_vector_is_left_out() -> None:
    kinds = {"command", "response", "data", "stream", "gsr", "gsr_clamp", "adc", "vbatt"}
    assert {vector["kind"] for vector in VECTORS} == kinds


@of_kind("command")
def test_commands(vector: Vector) -> None:
    data, expected = bytes.fromhex(vector["hex"]), vector["expected"]
    if "mask" in expected:
        assert commands.set_sensors(expected["mask"]) == data
    elif "rate_hz" in expected:
        divisor = commands.divisor_for(expected["rate_hz"])
        assert commands.set_sampling_rate(divisor) == data
    else:
        assert COMMANDS[vector["name"]] == data


def test_skin_conductance_and_pulse_are_asked_for() -> None:
    assert commands.set_sensors(commands.GSR_AND_PPG) == bytes.fromhex("08040100")


@of_kind("response")
def test_responses(vector: Vector) -> None:
    data, expected = bytes.fromhex(vector["hex"]), vector["expected"]
    if data[0] == 0xFE:
        assert decoded(vector, data) == [Nack()]
        return
    (message,) = decoded(vector, data if data[0] == 0xFF else b"\xff" + data)
    match message:
        case GsrRange():
            assert expected == {"gsr_range": message.setting}
        case ExpansionPower():
            assert expected == {"exp_power": message.on}
        case Inquiry():
            assert message.divisor == expected["divisor"]
            assert TICKS_PER_S / message.divisor == expected["rate_hz"]
            assert message.setup.hex() == expected["setup"]
            assert message.gsr_range == expected["gsr_range"]
            assert message.expansion_power == expected["exp_power"]
            assert list(message.channels) == expected["channels"]
        case _:
            pytest.fail(f"an unexpected {message}")


@of_kind("data")
def test_data_packets(vector: Vector) -> None:
    data, expected = bytes.fromhex(vector["hex"]), vector["expected"]
    # Without a full checksum a first packet is believed only with its successor.
    successor = successor_of(data, CrcMode(vector["crc"]))
    message = decoded(vector, data + successor)[0]
    assert isinstance(message, Packet)
    assert message.ticks == expected["ts"]
    values = dict(zip((NAMES[each] for each in vector["channels"]), message.values, strict=True))
    assert values == {name: expected[name] for name in values}
    assert message.ticks / TICKS_PER_S == expected["ts_seconds"]
    if "gsr" in expected:
        layout = Layout(vector["channels"])
        check_gsr(message.values[layout.index(Channel.GSR)], 4, expected["gsr"])
        ppg = millivolts([message.values[layout.index(Channel.PPG)]])
        assert ppg.tolist() == pytest.approx([expected["ppg_mv"]])
    if "vbatt_v" in expected:
        assert battery_volts(values["vbatt"]) == pytest.approx(expected["vbatt_v"])


def successor_of(packet: bytes, crc: CrcMode) -> bytes:
    body = packet[: len(packet) - crc]
    ticks = (int.from_bytes(body[1:4], "little") + 256) % (1 << 24)
    following = body[:1] + ticks.to_bytes(3, "little") + body[4:]
    return following + crc16(following).to_bytes(2, "little")[:crc]


@of_kind("stream")
def test_a_roll_over_is_no_gap(vector: Vector) -> None:
    messages = decoded(vector, bytes.fromhex(vector["hex"]))
    ticks = [message.ticks for message in messages if isinstance(message, Packet)]
    assert ticks == vector["expected"]["ts"]
    timeline = TickTimeline()
    timeline.started(256)
    first, second = (timeline.place(each, 10.0) for each in ticks)
    assert first is not None
    assert second is not None
    assert round((second.time_s - first.time_s) * 32768) == vector["expected"]["delta_ticks"]
    assert second.lost == 0


def check_gsr(raw: int, setting: int, expected: dict[str, Any]) -> None:
    assert gsr_ranges([raw], setting).tolist() == [expected["range"]]
    (value,) = conductance_us([raw], setting).tolist()
    if expected["range"] == 3 and expected["adc"] <= LARGEST_OPEN_ADC:
        # The vendor shows a tiny conductance; nothing is measured at all.
        assert expected["usiemens"] < 0.001
        assert np.isnan(value)
    else:
        assert value == pytest.approx(expected["usiemens"], rel=1e-12)


@of_kind("gsr")
def test_skin_conductance(vector: Vector) -> None:
    raw = int.from_bytes(bytes.fromhex(vector["hex"]), "little")
    check_gsr(raw, vector["range_setting"], vector["expected"])


@of_kind("gsr_clamp")
def test_a_fixed_range_is_limited(vector: Vector) -> None:
    expected = vector["expected"]
    assert clamped_kohm(expected["in_kohm"], expected["range"]) == expected["out_kohm"]


@of_kind("adc")
def test_adc_values_are_millivolts(vector: Vector) -> None:
    raw = int.from_bytes(bytes.fromhex(vector["hex"]), "little")
    assert millivolts([raw]).tolist() == pytest.approx([vector["expected"]["mv"]])


CHARGERS = {
    "charging": Charging.CHARGING,
    "fully_charged": Charging.FULL,
    "unknown": Charging.UNKNOWN,
    "checking": Charging.SUSPENDED,
}


@of_kind("vbatt")
def test_battery(vector: Vector) -> None:
    data, expected = bytes.fromhex(vector["hex"]), vector["expected"]
    reading = decode_reply(b"\x8a\x94" + data, ReplyForm())
    assert isinstance(reading, BatteryReading)
    assert (reading.adc, reading.charger) == (expected["adc"], expected["charge_byte"])
    assert reading.charger == CHARGERS[expected["charging"]]
    volts = battery_volts(reading.adc)
    assert volts == pytest.approx(expected["volts"])
    assert percent(volts) == pytest.approx(expected["percent"])
    if expected["charging"] == "checking":
        assert charge_percent(reading) is None
    else:
        assert charge_percent(reading) == pytest.approx(expected["percent"])


@pytest.mark.parametrize(
    ("last", "crc"), [(8, 0x48AA), (9, 0x2A5D)], ids=["even length", "odd length"]
)
def test_the_checksum_checks(last: int, crc: int) -> None:
    assert crc16(bytes(range(1, last + 1))) == crc


@pytest.mark.parametrize("text", ["fff4", "ff8a94560a8038"])
def test_the_vendor_s_messages_with_one_byte_of_checksum(text: str) -> None:
    data = bytes.fromhex(text)
    assert crc16(data[:-1]) & 0xFF == data[-1]


def test_the_vendor_s_data_packet_with_one_byte_of_checksum() -> None:
    data = bytes.fromhex("00efbe1be7093c083f097a")
    protocol = ShimmerProtocol()
    protocol.crc = CrcMode.LOW_BYTE
    protocol.expect_data(Layout([0x00, 0x01, 0x02]), 256)
    successor = successor_of(data, CrcMode.LOW_BYTE)
    (message, _), _ = protocol.feed(data + successor, 0.0)
    assert message == Packet(0x1BBEEF, (0x09E7, 0x083C, 0x093F))


def test_what_the_vendor_made_of_a_real_skin_is_what_we_make_of_it() -> None:
    file = Path(__file__).parent / "vectors/shimmer3_gsr_export.csv"
    ranges, told_us, told_kohm = np.loadtxt(file, delimiter=",", skiprows=1, usecols=(1, 2, 3)).T
    assert len(told_us) == 90
    # The range is in the upper two of 16 bits.
    every = np.arange(1 << 12)
    for number in np.unique(ranges.astype(int)):
        made_us = conductance_us(every | number << 14, commands.AUTO_RANGE)
        here = ranges == number
        nearest = np.nanargmin(np.abs(made_us[:, np.newaxis] - told_us[here]), axis=0)
        np.testing.assert_allclose(made_us[nearest], told_us[here], rtol=1e-9)
        np.testing.assert_allclose(1000 / made_us[nearest], told_kohm[here], rtol=1e-9)
