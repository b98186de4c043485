"""Commands and answers of a Shimmer: its identification, state and setup."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import structlog

from biosensor_common.errors import ProtocolError, ProtocolReason, TransportError, TransportReason
from biosensor_gateway.devices.shimmer.driver import messages
from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.messages import (
    STOP_STREAMING,
    Ack,
    BatteryReading,
    CrcMode,
    DaughterCard,
    ExpansionPower,
    Firmware,
    FirmwareKind,
    GsrRange,
    Hardware,
    Inquiry,
    Nack,
    Reply,
    ReplyForm,
    Stamped,
    Status,
)
from biosensor_gateway.devices.shimmer.driver.protocol import ShimmerProtocol
from biosensor_gateway.transports.dialogue import Dialogue
from biosensor_gateway.transports.link import ByteLink, Received

REPLY_TIMEOUT_S = 2.0
ATTEMPTS = 2
RESYNC_ATTEMPTS = 3
SETTLE_S = 0.05
"""Messages are sent in one write, so a pause of this length ends them."""

_ReplyT = TypeVar("_ReplyT", bound=Reply)
_BARRIERS: tuple[tuple[bytes, type[Reply]], ...] = (
    (messages.GET_HARDWARE, Hardware),
    (messages.GET_FIRMWARE, Firmware),
    (messages.GET_EXPANSION_POWER, ExpansionPower),
    (messages.GET_GSR_RANGE, GsrRange),
)

# The device may still be streaming from an earlier connection, in any format.
LISTEN_S = 0.5
QUIET_S = 0.3
STOP_ATTEMPTS = 3
ATTEMPT_S = 1.5
IDLE_BYTES = 16
"""An idle device may send this much unrequested data, for example when docked."""


class _Discarded(NamedTuple):
    size: int
    until_s: float | None
    quiet: bool


async def _stop_streaming(link: ByteLink) -> float | None:
    """Stop a streaming device on an open link, and discard what it sent.

    Returns
    -------
    float or None
        LSL time of the last bytes of a device that was streaming, None if it was not.

    Raises
    ------
    TransportError
        ``LOST``.
    """
    heard = await _discard(link, LISTEN_S, LISTEN_S)
    was_streaming, until_s = heard.size > IDLE_BYTES, heard.until_s
    for _ in range(STOP_ATTEMPTS):
        link.write(STOP_STREAMING)
        heard = await _discard(link, QUIET_S, ATTEMPT_S)
        until_s = heard.until_s or until_s
        if heard.quiet:
            break
    return until_s if was_streaming else None


async def _discard(link: ByteLink, quiet_s: float, limit_s: float) -> _Discarded:
    """Read until nothing arrives for ``quiet_s``, for at most ``limit_s``."""
    size, until_s = 0, None
    try:
        async with asyncio.timeout(limit_s):
            while True:
                received = await _next(link, quiet_s)
                if received is None:
                    return _Discarded(size, until_s, quiet=True)
                size, until_s = size + len(received.data), received.arrival
    except TimeoutError:
        return _Discarded(size, until_s, quiet=False)


async def _next(link: ByteLink, quiet_s: float) -> Received | None:
    try:
        async with asyncio.timeout(quiet_s):
            return await link.read()
    except TimeoutError:
        return None


class Conversation:
    """One connection to a Shimmer.

    The device answers in order, but most answers are a bare ACK, which does not identify the
    command. So after a command without a timely answer, nothing is sent until a query with a
    distinct answer was answered, so that no old answer is outstanding.

    Parameters
    ----------
    name
        Name of the device in error messages.
    link
        Not open yet.
    """

    def __init__(self, name: str, link: ByteLink) -> None:
        self._name = name
        self._link = link
        self._protocol = ShimmerProtocol()
        self._dialogue = Dialogue(self._receive, link.write)
        # Held for the whole exchange, including retries.
        self._turn = asyncio.Lock()
        self._has_heard_bytes = False
        self._has_heard_messages = False

    @property
    def dropped_bytes(self) -> int:
        """Number of bytes outside of valid messages."""
        return self._protocol.dropped_bytes

    async def open(self) -> float | None:
        """Open the link, and stop a device that is still streaming.

        Returns
        -------
        float or None
            LSL time until which it was found streaming, None if it was not.

        Raises
        ------
        TransportError
            From the link.
        """
        await self._link.open()
        streamed_until_s = await _stop_streaming(self._link)
        self._dialogue.begin()
        return streamed_until_s

    async def ask(self, command: bytes, wanted: type[_ReplyT]) -> _ReplyT:
        """Send a command and return its answer, which is `Ack` for commands that set something.

        Raises
        ------
        ProtocolError
            ``REFUSED``, ``NO_REPLY`` or ``GARBAGE``.
        TransportError
            ``SILENT`` if the device has never sent anything; ``LOST``.
        """
        async with self._turn:
            answer = await self._exchange(command, wanted)
            for _ in range(ATTEMPTS - 1):
                if answer is None:
                    await self._resynchronise(command)
                    answer = await self._exchange(command, wanted)
        if answer is None:
            raise self._no_reply()
        return answer

    async def tell(self, command: bytes) -> None:
        """Send a command that sets something; raises like `ask`."""
        await self.ask(command, Ack)

    async def poll(self, command: bytes, wanted: type[_ReplyT]) -> _ReplyT | None:
        """Query a streaming device once; None if it does not answer or refuses."""
        async with self._turn:
            try:
                return await self._exchange(command, wanted)
            except ProtocolError:
                return None

    def use_form(self, form: ReplyForm) -> None:
        """Expect answers in the format of this kind of device."""
        self._protocol.form = form

    async def use_crc(self, mode: CrcMode) -> None:
        """Enable checksums; raises like `ask`."""
        # The answer to this command already has a checksum.
        self._protocol.crc = mode
        await self.tell(messages.set_crc(mode))

    async def start_streaming(self, layout: Layout, divisor: int) -> None:
        """Start streaming; raises like `ask`."""
        self._protocol.expect_data(layout, divisor)
        await self.tell(messages.START_STREAMING)

    async def stream(self, listener: Callable[[Sequence[Stamped]], None]) -> None:
        """Pass on all messages since `open`, grouped by read.

        Raises
        ------
        TransportError
            ``LOST``.
        """
        await self._dialogue.stream(listener)

    async def close(self) -> None:
        """Stop the device without waiting for it, and close the link."""
        self._link.write(messages.STOP_STREAMING)
        await self._dialogue.close()
        await self._link.close()

    async def _exchange(self, command: bytes, wanted: type[_ReplyT]) -> _ReplyT | None:
        """Send a command and wait for the answer; None after a timeout."""

        def answer(stamped: Stamped) -> _ReplyT | Nack | None:
            return stamped.message if isinstance(stamped.message, (wanted, Nack)) else None

        reply = await self._dialogue.ask(command, answer, REPLY_TIMEOUT_S)
        if isinstance(reply, Nack):
            raise self._refusal(command)
        return reply

    async def _resynchronise(self, unanswered: bytes) -> None:
        """Wait until no answers are outstanding."""
        self._dialogue.hear(self._noted(self._protocol.give_up()))
        barriers = [barrier for barrier in _BARRIERS if barrier[0] != unanswered]
        for question, answer in barriers[:RESYNC_ATTEMPTS]:
            # The device may still wait for lost arguments, and would take this command as one.
            self._link.write(messages.TEST_CONNECTION)
            try:
                if await self._exchange(question, answer) is not None:
                    return
            except ProtocolError:
                continue  # the refusal of the previous command
        raise self._no_reply()

    def _refusal(self, command: bytes) -> ProtocolError:
        message = (
            f"{self._name}: the device refuses command 0x{command[0]:02X}; "
            "end a recording to its SD card and take it off its dock"
        )
        return ProtocolError(ProtocolReason.REFUSED, message)

    def _no_reply(self) -> TransportError | ProtocolError:
        if not self._has_heard_bytes:
            message = f"{self._name}: the device sends nothing; switch it off and on"
            return TransportError(TransportReason.SILENT, message)
        if not self._has_heard_messages:
            message = (
                f"{self._name}: the device that answers is not a Shimmer; choose its port in the "
                "settings"
            )
            return ProtocolError(ProtocolReason.GARBAGE, message)
        message = f"{self._name}: the device does not answer; switch it off and on"
        return ProtocolError(ProtocolReason.NO_REPLY, message)

    async def _receive(self) -> list[Stamped]:
        try:
            async with asyncio.timeout(SETTLE_S if self._protocol.undecided else None):
                data, arrival_s = await self._link.read()
        except TimeoutError:
            return self._noted(self._protocol.settle())
        self._has_heard_bytes = True
        return self._noted(self._protocol.feed(data, arrival_s))

    def _noted(self, found: list[Stamped]) -> list[Stamped]:
        self._has_heard_messages = self._has_heard_messages or bool(found)
        return found


SHIMMER3, SHIMMER3R = 3, 10

# Earlier versions, and BtStream, had two-byte timestamps that overflow every two seconds.
_FIRST_LOG_AND_STREAM = (0, 5, 4)
_FIRST_BT_STREAM = (0, 7, 3)
_FIRST_BATTERY = (0, 5, 9)
_FIRST_CRC = (0, 13, 7)
_FIRST_BARE_STATUS = (0, 15, 4)
_FIRST_PRESSURE_CHIP = (0, 16, 6)
_FIRST_3R_WITH_TWO_STATUS_BYTES = (1, 0, 24)
_UPDATE = "install LogAndStream 0.13.7 or later with Shimmer's Consensys"


@dataclass(frozen=True, slots=True)
class Kind:
    """Hardware and firmware of a Shimmer."""

    hardware: int
    firmware: Firmware

    @property
    def has_status(self) -> bool:
        """Whether it reports its status and battery; BtStream does not."""
        return self._is_log_and_stream(_FIRST_BATTERY)

    @property
    def has_crc(self) -> bool:
        """Whether it supports checksums."""
        return self._is_log_and_stream(_FIRST_CRC)

    @property
    def has_bare_status(self) -> bool:
        """Whether it can omit the ACK before an unrequested status."""
        return self._is_log_and_stream(_FIRST_BARE_STATUS)

    @property
    def tells_pressure_chip(self) -> bool:
        """Whether it reports the type of its pressure sensor with the coefficients."""
        is_3r = self.hardware == SHIMMER3R
        return is_3r or self._is_log_and_stream(_FIRST_PRESSURE_CHIP)

    @property
    def form(self) -> ReplyForm:
        """Format of its answers."""
        if self.hardware != SHIMMER3R:
            return ReplyForm()
        two_bytes = self.firmware.version >= _FIRST_3R_WITH_TWO_STATUS_BYTES
        return ReplyForm(setup_bytes=7, status_bytes=2 if two_bytes else 1, calibration_blocks=6)

    def layout(self, channels: Iterable[int]) -> Layout:
        """Return the layout of its data packets from the channels of an inquiry."""
        return Layout(channels, is_3r=self.hardware == SHIMMER3R)

    def _is_log_and_stream(self, first: tuple[int, int, int]) -> bool:
        firmware = self.firmware
        return firmware.kind == FirmwareKind.LOG_AND_STREAM and firmware.version >= first


async def identify(talk: Conversation, name: str) -> Kind:
    """Identify the device, and enable checksums and unambiguous status messages.

    Raises
    ------
    ProtocolError
        ``UNSUPPORTED``, or as for :meth:`Conversation.ask`.
    TransportError
        As for :meth:`Conversation.ask`.
    """
    hardware = await talk.ask(messages.GET_HARDWARE, Hardware)
    firmware = await talk.ask(messages.GET_FIRMWARE, Firmware)
    kind = Kind(hardware.version, firmware)
    fault = _unsupported(kind)
    if fault:
        raise ProtocolError(ProtocolReason.UNSUPPORTED, f"{name}: {fault}")
    talk.use_form(kind.form)
    if kind.has_bare_status:
        await talk.tell(messages.NO_ACK_BEFORE_STATUS)
    if kind.has_crc:
        await talk.use_crc(CrcMode.FULL)
    return kind


def _unsupported(kind: Kind) -> str:
    """Return why a device is not supported and what to do; empty if it is."""
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


_log = structlog.get_logger("biosensor_gateway.shimmer")


async def ask_for_the_state(talk: Conversation, kind: Kind) -> dict[str, str]:
    """Query status and battery; the listener processes the answers.

    Returns
    -------
    dict of str to str
        Why the device does not report them, by data name.

    Raises
    ------
    ProtocolError, TransportError
        As for :meth:`Conversation.ask`, except that the battery may be refused.
    """
    if kind.has_status:
        await talk.ask(messages.GET_STATUS, Status)
        try:
            await talk.ask(messages.GET_BATTERY, BatteryReading)
        except ProtocolError as error:
            if error.reason is not ProtocolReason.REFUSED:
                raise
            return {"bat": "it does not accept the request for its voltage"}
    return {}


async def expansion_board(talk: Conversation, name: str) -> int | None:
    """Return the number of the expansion board; None if unknown.

    Raises
    ------
    TransportError
        As for :meth:`Conversation.ask`.
    """
    try:
        card = await talk.ask(messages.GET_DAUGHTER_CARD, DaughterCard)
    except ProtocolError as error:
        _log.warning("the expansion board is unknown", port=name, cause=str(error))
        return None
    return card.data[0] if card.data else None


async def make_right(
    talk: Conversation, changes_to: Callable[[Inquiry], Mapping[str, bytes]], name: str
) -> Inquiry:
    """Change wrong settings found by an inquiry; return the new setup.

    Parameters
    ----------
    changes_to
        Returns the necessary commands by the setting that they change.
    name
        Name of the device in error messages.

    Raises
    ------
    ProtocolError
        ``REFUSED`` if it does not accept a setting, or as for :meth:`Conversation.ask`.
    TransportError
        As for :meth:`Conversation.ask`.
    """
    present = await talk.ask(messages.INQUIRY, Inquiry)
    changes = changes_to(present)
    for command in changes.values():
        await talk.tell(command)
    if changes:
        present = await talk.ask(messages.INQUIRY, Inquiry)
        refuse_if_left(changes_to(present), name)
    return present


def refuse_if_left(changes: Mapping[str, bytes], name: str) -> None:
    """Raise an error for settings that the device did not accept.

    Raises
    ------
    ProtocolError
        ``REFUSED`` if any changes are left.
    """
    if changes:
        message = f"{name}: the device did not accept {', '.join(changes)}; switch it off and on"
        raise ProtocolError(ProtocolReason.REFUSED, message)
