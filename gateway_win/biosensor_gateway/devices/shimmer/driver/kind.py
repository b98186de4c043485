"""Tells Shimmers apart, and makes their messages safe."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.shimmer.driver import commands
from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.commands import CrcMode
from biosensor_gateway.devices.shimmer.driver.conversation import Conversation
from biosensor_gateway.devices.shimmer.driver.messages import Firmware, FirmwareKind, Hardware
from biosensor_gateway.devices.shimmer.driver.replies import ReplyForm

SHIMMER3, SHIMMER3R = 3, 10

_FIRST_LOG_AND_STREAM = (0, 5, 4)
"""Before, timestamps had two bytes and turned every two seconds; so had BtStream's."""
_FIRST_BT_STREAM = (0, 7, 3)
_FIRST_BATTERY = (0, 5, 9)
_FIRST_CRC = (0, 13, 7)
_FIRST_BARE_STATUS = (0, 15, 4)
_FIRST_PRESSURE_CHIP = (0, 16, 6)
_FIRST_3R_WITH_TWO_STATUS_BYTES = (1, 0, 24)
_UPDATE = "install LogAndStream 0.13.7 or later with Shimmer's Consensys"


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
    def tells_pressure_chip(self) -> bool:
        """Whether it says which pressure sensor it has, with its coefficients."""
        is_3r = self.hardware == SHIMMER3R
        return is_3r or self._is_log_and_stream(_FIRST_PRESSURE_CHIP)

    @property
    def form(self) -> ReplyForm:
        """Sizes of its answers."""
        if self.hardware != SHIMMER3R:
            return ReplyForm()
        two_bytes = self.firmware.version >= _FIRST_3R_WITH_TWO_STATUS_BYTES
        return ReplyForm(setup_bytes=7, status_bytes=2 if two_bytes else 1, calibration_blocks=6)

    def layout(self, channels: Iterable[int]) -> Layout:
        """Return the layout of its data packets, channels in the order of an inquiry."""
        return Layout(channels, is_3r=self.hardware == SHIMMER3R)

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


def _unsupported(kind: Kind) -> str:
    """Say why the driver cannot use a device, and what to do; empty if it can."""
    firmware = kind.firmware
    first = {
        FirmwareKind.LOG_AND_STREAM.value: _FIRST_LOG_AND_STREAM,
        FirmwareKind.BT_STREAM.value: _FIRST_BT_STREAM,
    }.get(firmware.kind)
    if kind.hardware not in {SHIMMER3, SHIMMER3R}:
        return f"Shimmer hardware {kind.hardware} is not supported; use a Shimmer3 or Shimmer3R"
    if first is None:
        return f"{firmware} is not supported; {_UPDATE}"
    return f"{firmware} is too old; {_UPDATE}" if firmware.version < first else ""
