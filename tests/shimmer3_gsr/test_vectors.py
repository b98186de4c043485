"""Every vector of the notes: bytes in, meaning out."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from structlog.testing import capture_logs

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.shimmer.driver import messages as commands
from biosensor_gateway.devices.shimmer.driver.calibration import millivolts
from biosensor_gateway.devices.shimmer.driver.channels import Channel, Layout
from biosensor_gateway.devices.shimmer.driver.conversation import Conversation, Kind, identify
from biosensor_gateway.devices.shimmer.driver.messages import (
    TICKS_PER_S,
    BatteryReading,
    Charging,
    CrcMode,
    DaughterCard,
    ExpansionPower,
    Firmware,
    FirmwareKind,
    GsrRange,
    Hardware,
    Inquiry,
    Message,
    Nack,
    Packet,
    ReplyForm,
    Status,
    StatusFlag,
    crc16,
    decode_reply,
)
from biosensor_gateway.devices.shimmer.driver.packets import (
    TickTimeline,
    battery_volts,
    charge_percent,
    percent,
)
from biosensor_gateway.devices.shimmer.driver.protocol import ShimmerProtocol
from biosensor_gateway.devices.shimmer3_gsr.driver import (
    LARGEST_OPEN_ADC,
    Measurement,
    Wanted,
    clamped_kohm,
    conductance_us,
    gsr_ranges,
    set_up,
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


# What a device is asked and told before it starts, and which devices are refused.

WANTED = Wanted(256, 4)
RIGHT: dict[str, int] = {"mask": commands.GSR_AND_PPG, "range": 4, "power": 1, "divisor": 256}
MASKS = {commands.GSR_AND_PPG: (0x12, 0x1C), 0x000080: (0, 1, 2), 0x002104: (3, 0x12, 0x1C)}
SETS = {0x08: "mask", 0x21: "range", 0x5E: "power", 0x05: "divisor"}
LOG_AND_STREAM = FirmwareKind.LOG_AND_STREAM


class Device:
    """Stands in for a conversation: answers at once and keeps what it is told to."""

    def __init__(
        self,
        firmware: tuple[int, int, int] = (1, 1, 2),
        kind: int = LOG_AND_STREAM,
        hardware: int = 3,
        flash: Mapping[str, int] = RIGHT,
        board: int | None = 48,
        obeys: bool = True,
    ) -> None:
        self.kind = Kind(hardware, Firmware(kind, firmware))
        self.flash = dict(flash)
        self.crc = CrcMode.OFF
        self.form = ReplyForm()
        self.asked: list[bytes] = []
        self.told: list[bytes] = []
        self._board = board
        self._obeys = obeys

    async def ask(self, command: bytes, wanted: type[Any]) -> Any:
        self.asked.append(command)
        if wanted is DaughterCard and self._board is None:
            raise ProtocolError(ProtocolReason.NO_REPLY, "no answer")
        setup = bytes((0, 0, 0, self.flash["range"] << 1 | self.flash["power"]))
        answer = {
            Hardware: Hardware(self.kind.hardware),
            Firmware: self.kind.firmware,
            DaughterCard: DaughterCard(bytes((self._board or 0, 1, 0))),
            Status: Status(StatusFlag(0)),
            BatteryReading: BatteryReading(2600, 0xFF),
            Inquiry: Inquiry(self.flash["divisor"], setup, MASKS[self.flash["mask"]]),
        }[wanted]
        assert isinstance(answer, wanted)
        return answer

    async def tell(self, command: bytes) -> None:
        self.told.append(command)
        if self._obeys and command[0] in SETS:
            self.flash[SETS[command[0]]] = int.from_bytes(command[1:], "little")

    async def use_crc(self, mode: CrcMode) -> None:
        self.crc = mode

    def use_form(self, form: ReplyForm) -> None:
        self.form = form

    @property
    def conversation(self) -> Conversation:
        return cast("Conversation", self)

    async def identify(self) -> Kind:
        return await identify(self.conversation, "COM7")

    async def set_up(self, wanted: Wanted = WANTED) -> Measurement:
        return await set_up(self.conversation, self.kind, wanted, "COM7")


@pytest.mark.parametrize(
    ("firmware", "bare_status", "crc"),
    [
        ((0, 5, 4), False, CrcMode.OFF),
        ((0, 13, 6), False, CrcMode.OFF),
        ((0, 13, 7), False, CrcMode.FULL),
        ((0, 15, 3), False, CrcMode.FULL),
        ((0, 15, 4), True, CrcMode.FULL),
        ((1, 1, 2), True, CrcMode.FULL),
    ],
)
async def test_what_makes_messages_safe_is_switched_on_where_the_firmware_has_it(
    firmware: tuple[int, int, int], bare_status: bool, crc: CrcMode
) -> None:
    device = Device(firmware)
    assert await device.identify() == device.kind
    assert device.told == [commands.NO_ACK_BEFORE_STATUS] * bare_status
    assert device.crc is crc


@pytest.mark.parametrize(
    ("device", "words"),
    [
        (Device(hardware=2), "Shimmer hardware 2 is not supported; use a Shimmer3 or Shimmer3R"),
        (Device(kind=FirmwareKind.SD_LOG), "SDLog 1.1.2 is not supported; install LogAndStream"),
        (Device(kind=9), "firmware 9 1.1.2 is not supported; install LogAndStream"),
        (Device((0, 5, 3)), "LogAndStream 0.5.3 is too old; install LogAndStream"),
        (Device((0, 7, 2), FirmwareKind.BT_STREAM), "BtStream 0.7.2 is too old; install"),
    ],
)
async def test_others_are_refused_with_an_advice(device: Device, words: str) -> None:
    with pytest.raises(ProtocolError) as caught:
        await device.identify()
    assert caught.value.reason is ProtocolReason.UNSUPPORTED
    assert str(caught.value).startswith(f"COM7: {words}")
    assert device.told == []


async def test_bt_stream_is_not_asked_what_it_does_not_know() -> None:
    device = Device((0, 8, 0), FirmwareKind.BT_STREAM)
    assert await device.identify() == device.kind
    await device.set_up()
    assert device.crc is CrcMode.OFF
    assert commands.GET_BATTERY not in device.asked
    assert commands.GET_STATUS not in device.asked


@pytest.mark.parametrize(("patch", "status_bytes"), [(23, 1), (24, 2)])
async def test_a_shimmer3r_has_longer_answers(patch: int, status_bytes: int) -> None:
    device = Device((1, 0, patch), hardware=10)
    await device.identify()
    assert device.form == ReplyForm(7, status_bytes, calibration_blocks=6)
    assert (await device.set_up()).layout.channels == (0x12, 0x1C)


async def test_what_is_right_is_not_written_again() -> None:
    device = Device()
    measurement = await device.set_up()
    assert device.told == []
    assert measurement.layout.channels == (0x12, 0x1C)
    assert (measurement.divisor, measurement.gsr_setting) == (256, 4)


@pytest.mark.parametrize(
    ("wrong", "command"),
    [
        ({"mask": 0x000080}, "08040100"),
        ({"mask": 0x002104}, "08040100"),
        ({"range": 2}, "2104"),
        ({"power": 0}, "5e01"),
        ({"divisor": 640}, "050001"),
    ],
)
async def test_what_is_wrong_is_set_and_checked(wrong: dict[str, int], command: str) -> None:
    device = Device(flash=RIGHT | wrong)
    await device.set_up()
    assert device.told == [bytes.fromhex(command)]
    assert device.flash == RIGHT
    assert device.asked.count(commands.INQUIRY) == 2


async def test_the_wanted_rate_and_range_are_set() -> None:
    device = Device()
    measurement = await device.set_up(Wanted(64, 1))
    assert device.flash == RIGHT | {"divisor": 64, "range": 1}
    assert measurement.rate_hz == 512


async def test_a_device_that_keeps_its_own_ways_is_not_started() -> None:
    device = Device(flash=RIGHT | {"power": 0, "divisor": 640}, obeys=False)
    with pytest.raises(ProtocolError, match="power of the optical probe, sampling rate") as caught:
        await device.set_up()
    assert caught.value.reason is ProtocolReason.REFUSED


@pytest.mark.parametrize("board", [None, 14, 31, 48])
async def test_another_board_is_warned_of(board: int | None) -> None:
    with capture_logs() as logs:
        measurement = await Device(board=board).set_up()
    assert len(logs) == (board is None)
    assert bool(measurement.remarks) == (board == 31)
