"""Getting a Shimmer ready: what it is, what it can, and how it shall measure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import structlog

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.shimmer3_gsr.driver import commands
from biosensor_gateway.devices.shimmer3_gsr.driver.channels import Channel, Layout
from biosensor_gateway.devices.shimmer3_gsr.driver.conversation import Conversation
from biosensor_gateway.devices.shimmer3_gsr.driver.crc import CrcMode
from biosensor_gateway.devices.shimmer3_gsr.driver.emitter import Measurement
from biosensor_gateway.devices.shimmer3_gsr.driver.messages import (
    BatteryReading,
    DaughterCard,
    Firmware,
    FirmwareKind,
    Hardware,
    Inquiry,
    Status,
)
from biosensor_gateway.devices.shimmer3_gsr.driver.replies import ReplyForm

SHIMMER3, SHIMMER3R = 3, 10
GSR_BOARDS = frozenset({14, 48})

_FIRST_LOG_AND_STREAM = (0, 5, 4)
"""Before, timestamps had two bytes and turned every two seconds; so had BtStream's."""
_FIRST_BT_STREAM = (0, 7, 3)
_FIRST_BATTERY = (0, 5, 9)
_FIRST_CRC = (0, 13, 7)
_FIRST_BARE_STATUS = (0, 15, 4)
_FIRST_3R_WITH_TWO_STATUS_BYTES = (1, 0, 24)
_UPDATE = "install LogAndStream 0.13.7 or later with Shimmer's Consensys"

_log = structlog.get_logger("biosensor_gateway.shimmer3_gsr")


class Wanted(NamedTuple):
    """How to measure: sampling divisor, and feedback resistor (4 for automatic)."""

    divisor: int
    gsr_setting: int


@dataclass(frozen=True, slots=True)
class Kind:
    """Which Shimmer this is."""

    hardware: int
    firmware: Firmware

    @property
    def has_status(self) -> bool:
        """Whether it tells its status and battery: BtStream does not."""
        return self._is_log_and_stream(_FIRST_BATTERY)

    @property
    def has_crc(self) -> bool:
        """Whether it can append checksums."""
        return self._is_log_and_stream(_FIRST_CRC)

    @property
    def has_bare_status(self) -> bool:
        """Whether it can leave out the ACK before an unasked status."""
        return self._is_log_and_stream(_FIRST_BARE_STATUS)

    @property
    def form(self) -> ReplyForm:
        """Sizes of its answers."""
        if self.hardware != SHIMMER3R:
            return ReplyForm()
        two_bytes = self.firmware.version >= _FIRST_3R_WITH_TWO_STATUS_BYTES
        return ReplyForm(setup_bytes=7, status_bytes=2 if two_bytes else 1)

    def _is_log_and_stream(self, first: tuple[int, int, int]) -> bool:
        firmware = self.firmware
        return firmware.kind == FirmwareKind.LOG_AND_STREAM and firmware.version >= first


async def identify(talk: Conversation, name: str) -> Kind:
    """Ask what the device is, and switch on what makes its messages safe.

    Raises
    ------
    ProtocolError
        ``UNSUPPORTED``, or as :meth:`Conversation.ask`.
    TransportError
        As :meth:`Conversation.ask`.
    """
    hardware = await talk.ask(commands.GET_HARDWARE, Hardware)
    firmware = await talk.ask(commands.GET_FIRMWARE, Firmware)
    kind = Kind(hardware.version, firmware)
    fault = _unsupported(kind)
    if fault:
        raise ProtocolError(ProtocolReason.UNSUPPORTED, f"{name}: {fault}")
    talk.use_form(kind.form)
    if kind.has_bare_status:
        await talk.tell(commands.NO_ACK_BEFORE_STATUS)
    if kind.has_crc:
        await talk.use_crc(CrcMode.FULL)
    return kind


async def set_up(talk: Conversation, kind: Kind, wanted: Wanted, name: str) -> Measurement:
    """Make the device measure skin conductance and pulse as wanted; it does not start yet.

    Settings are written to the device's flash, so what is right already is left alone.

    Raises
    ------
    ProtocolError
        ``REFUSED`` if it does not take a setting, or as :meth:`Conversation.ask`.
    TransportError
        As :meth:`Conversation.ask`.
    """
    await _check_board(talk, name)
    if kind.has_status:
        # For the listener.
        await talk.ask(commands.GET_STATUS, Status)
        await talk.ask(commands.GET_BATTERY, BatteryReading)
    present = await talk.ask(commands.INQUIRY, Inquiry)
    changes = _changes(present, wanted)
    for command in changes.values():
        await talk.tell(command)
    if changes:
        present = await talk.ask(commands.INQUIRY, Inquiry)
        refused = _changes(present, wanted)
        if refused:
            message = f"{name}: the device did not take {', '.join(refused)}; switch it off and on"
            raise ProtocolError(ProtocolReason.REFUSED, message)
    # The scale of a Shimmer3R's ADC inputs was never confirmed.
    has_ppg_scale = kind.hardware == SHIMMER3
    return Measurement(Layout(present.channels), wanted.divisor, wanted.gsr_setting, has_ppg_scale)


def _unsupported(kind: Kind) -> str:
    """Say why the driver cannot use a device, and what to do; empty if it can."""
    firmware = kind.firmware
    first = {
        FirmwareKind.LOG_AND_STREAM.value: _FIRST_LOG_AND_STREAM,
        FirmwareKind.BT_STREAM.value: _FIRST_BT_STREAM,
    }.get(firmware.kind)
    if kind.hardware not in {SHIMMER3, SHIMMER3R}:
        return f"Shimmer hardware {kind.hardware} is not supported; use a Shimmer3 GSR+"
    if first is None:
        return f"{firmware} is not supported; {_UPDATE}"
    return f"{firmware} is too old; {_UPDATE}" if firmware.version < first else ""


async def _check_board(talk: Conversation, name: str) -> None:
    """Warn of a Shimmer without the GSR board: it measures, but nothing that makes sense."""
    try:
        card = await talk.ask(commands.GET_DAUGHTER_CARD, DaughterCard)
    except ProtocolError as error:
        _log.warning("the expansion board is unknown", port=name, cause=str(error))
        return
    if card.data[:1] and card.data[0] not in GSR_BOARDS:
        _log.warning("the expansion board is no GSR+ board", port=name, board=card.data[0])


def _changes(present: Inquiry, wanted: Wanted) -> dict[str, bytes]:
    """Return the commands that are needed, by what they set."""
    right = {
        "sensors": set(present.channels) == {Channel.GSR, Channel.PPG},
        "GSR range": present.gsr_range == wanted.gsr_setting,
        "power of the optical probe": present.expansion_power,
        "sampling rate": present.divisor == wanted.divisor,
    }
    setting = {
        "sensors": commands.set_sensors(commands.GSR_AND_PPG),
        "GSR range": commands.set_gsr_range(wanted.gsr_setting),
        "power of the optical probe": commands.POWER_THE_PROBE,
        "sampling rate": commands.set_sampling_rate(wanted.divisor),
    }
    return {name: command for name, command in setting.items() if not right[name]}
