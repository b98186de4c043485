"""What a device is asked and told before it starts, and which devices are refused."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import pytest
from structlog.testing import capture_logs

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.shimmer.driver import commands
from biosensor_gateway.devices.shimmer.driver.commands import CrcMode
from biosensor_gateway.devices.shimmer.driver.conversation import Conversation, Kind, identify
from biosensor_gateway.devices.shimmer.driver.messages import (
    BatteryReading,
    DaughterCard,
    Firmware,
    FirmwareKind,
    Hardware,
    Inquiry,
    ReplyForm,
    Status,
    StatusFlag,
)
from biosensor_gateway.devices.shimmer3_gsr.driver import Wanted, set_up
from biosensor_gateway.devices.shimmer3_gsr.driver.emitter import Measurement

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
        await Device(board=board).set_up()
    assert len(logs) == (board not in {14, 48})
