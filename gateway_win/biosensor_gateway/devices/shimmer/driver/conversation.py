"""Commands and their answers over a byte link, one at a time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.shimmer.driver import commands
from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.commands import STOP_STREAMING, CrcMode
from biosensor_gateway.devices.shimmer.driver.messages import (
    Ack,
    ExpansionPower,
    Firmware,
    GsrRange,
    Hardware,
    Nack,
    Reply,
    Stamped,
)
from biosensor_gateway.devices.shimmer.driver.protocol import ShimmerProtocol
from biosensor_gateway.devices.shimmer.driver.replies import ReplyForm
from biosensor_gateway.transports.dialogue import Dialogue
from biosensor_gateway.transports.link import ByteLink, Received

REPLY_TIMEOUT_S = 2.0
ATTEMPTS = 2
RESYNC_ATTEMPTS = 3
SETTLE_S = 0.05
"""What belongs together is sent in one write: so long a pause ends it."""

_ReplyT = TypeVar("_ReplyT", bound=Reply)
_BARRIERS: tuple[tuple[bytes, type[Reply]], ...] = (
    (commands.GET_HARDWARE, Hardware),
    (commands.GET_FIRMWARE, Firmware),
    (commands.GET_EXPANSION_POWER, ExpansionPower),
    (commands.GET_GSR_RANGE, GsrRange),
)

# The device behind a new link may have been left streaming, in any format.
LISTEN_S = 0.5
QUIET_S = 0.3
STOP_ATTEMPTS = 3
ATTEMPT_S = 1.5
IDLE_BYTES = 16
"""An idle device may say this much, unasked: that it was docked."""


class _Discarded(NamedTuple):
    size: int
    until_s: float | None
    quiet: bool


async def _stop_streaming(link: ByteLink) -> float | None:
    """Make the device behind an open link silent, and throw away what it said.

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
    """Read until nothing comes for ``quiet_s``, for at most ``limit_s``."""
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

    The device answers in order, but most answers are a bare ACK that does not say what it
    answers. So after a command that was not answered in time, nothing is sent until a
    question with an answer of its own kind is answered: what was owed is then behind.

    Parameters
    ----------
    name
        What error messages call the device.
    link
        Not yet open.
    """

    def __init__(self, name: str, link: ByteLink) -> None:
        self._name = name
        self._link = link
        self._protocol = ShimmerProtocol()
        self._dialogue = Dialogue(self._receive, link.write)
        # Asking once more belongs to the first time.
        self._turn = asyncio.Lock()
        self._has_heard_bytes = False
        self._has_heard_messages = False

    @property
    def dropped_bytes(self) -> int:
        """Bytes that belonged to no valid message."""
        return self._protocol.dropped_bytes

    async def open(self) -> float | None:
        """Open the link, and stop a device that was left streaming.

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
        """Send a command and return its answer; `Ack` is wanted of one that sets something.

        Raises
        ------
        ProtocolError
            ``REFUSED``, ``NO_REPLY`` or ``GARBAGE``.
        TransportError
            ``SILENT`` if the device never said anything; ``LOST``.
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
        """Send a command that sets something; raises as `ask`."""
        await self.ask(command, Ack)

    async def poll(self, command: bytes, wanted: type[_ReplyT]) -> _ReplyT | None:
        """Ask once, of a device that is streaming; None if it does not answer or refuses."""
        async with self._turn:
            try:
                return await self._exchange(command, wanted)
            except ProtocolError:
                return None

    def use_form(self, form: ReplyForm) -> None:
        """Expect answers in the form of this kind of device."""
        self._protocol.form = form

    async def use_crc(self, mode: CrcMode) -> None:
        """Switch checksums on; raises as `ask`."""
        # The answer to the command carries one already.
        self._protocol.crc = mode
        await self.tell(commands.set_crc(mode))

    async def start_streaming(self, layout: Layout, divisor: int) -> None:
        """Start; raises as `ask`."""
        self._protocol.expect_data(layout, divisor)
        await self.tell(commands.START_STREAMING)

    async def stream(self, listener: Callable[[Sequence[Stamped]], None]) -> None:
        """Pass on all messages since `open`, those of a read at a time.

        Raises
        ------
        TransportError
            ``LOST``.
        """
        await self._dialogue.stream(listener)

    async def close(self) -> None:
        """Stop the device without waiting for it, and close the link."""
        self._link.write(commands.STOP_STREAMING)
        await self._dialogue.close()
        await self._link.close()

    async def _exchange(self, command: bytes, wanted: type[_ReplyT]) -> _ReplyT | None:
        """Send, and wait for the answer; None if it does not come in time."""

        def answer(stamped: Stamped) -> _ReplyT | Nack | None:
            return stamped.message if isinstance(stamped.message, (wanted, Nack)) else None

        reply = await self._dialogue.ask(command, answer, REPLY_TIMEOUT_S)
        if isinstance(reply, Nack):
            raise self._refusal(command)
        return reply

    async def _resynchronise(self, unanswered: bytes) -> None:
        """Wait until every answer that is still owed has come or cannot come any more."""
        self._dialogue.hear(self._noted(self._protocol.give_up()))
        barriers = [barrier for barrier in _BARRIERS if barrier[0] != unanswered]
        for question, answer in barriers[:RESYNC_ATTEMPTS]:
            # It may still wait for arguments that got lost on the way; this becomes one.
            self._link.write(commands.TEST_CONNECTION)
            try:
                if await self._exchange(question, answer) is not None:
                    return
            except ProtocolError:
                continue  # the refusal of what was asked before
        raise self._no_reply()

    def _refusal(self, command: bytes) -> ProtocolError:
        message = (
            f"{self._name}: the device refuses command 0x{command[0]:02X}; "
            "end a recording to its SD card and take it off its dock"
        )
        return ProtocolError(ProtocolReason.REFUSED, message)

    def _no_reply(self) -> TransportError | ProtocolError:
        if not self._has_heard_bytes:
            message = f"{self._name}: the device says nothing; switch it off and on"
            return TransportError(TransportReason.SILENT, message)
        if not self._has_heard_messages:
            message = f"{self._name}: what answers is no Shimmer; choose its port in the settings"
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
