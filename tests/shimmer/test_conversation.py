"""Commands and answers, with a scripted device: late, lost, refused and unasked ones."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager

import pytest

from biosensor_common.errors import (
    ProtocolError,
    ProtocolReason,
    TransportError,
    TransportReason,
)
from biosensor_gateway.devices.shimmer.driver import messages
from biosensor_gateway.devices.shimmer.driver.channels import Layout
from biosensor_gateway.devices.shimmer.driver.conversation import Conversation
from biosensor_gateway.devices.shimmer.driver.messages import (
    Ack,
    CrcMode,
    ExpansionPower,
    Firmware,
    Hardware,
    Packet,
    Stamped,
    Status,
    StatusFlag,
    checksum,
)
from biosensor_gateway.system.clock import LSL_CLOCK
from biosensor_gateway.transports.link import Received

pytestmark = pytest.mark.usefixtures("virtual_clock")

ACK, NACK = b"\xff", b"\xfe"
UNASKED = b"\xff\x8a\x71\x01"
SET_RATE = messages.set_sampling_rate(256)
ANSWERS = {
    messages.GET_HARDWARE: b"\xff\x25\x03",
    messages.GET_FIRMWARE: bytes.fromhex("ff2f03000000100b"),
    messages.GET_EXPANSION_POWER: b"\xff\x5f\x01",
    messages.GET_GSR_RANGE: b"\xff\x22\x04",
    messages.GET_STATUS: b"\xff\x8a\x71\x10",
}

Script = Callable[[bytes], "bytes | None"]


class ScriptedLink:
    """Answers what is written by a script; None ends the link."""

    def __init__(self, script: Script) -> None:
        self.written: list[bytes] = []
        self.script = script
        self.closed = False
        self._incoming: asyncio.Queue[Received | None] = asyncio.Queue()

    async def open(self) -> None: ...

    async def read(self) -> Received:
        received = await self._incoming.get()
        if received is None:
            raise TransportError(TransportReason.LOST, "the link was cut")
        return received

    def write(self, data: bytes) -> None:
        self.written.append(data)
        self.send(self.script(data))

    def send(self, data: bytes | None) -> None:
        if data != b"":
            self._incoming.put_nowait(None if data is None else Received(data, LSL_CLOCK()))

    async def close(self) -> None:
        self.closed = True


class Talk:
    def __init__(self, script: Script) -> None:
        self.link = ScriptedLink(script)
        self.heard: list[Stamped] = []
        self.conversation = Conversation("COM7", self.link)

    def hear(self, found: Sequence[Stamped]) -> None:
        self.heard += found

    @property
    def asked(self) -> list[bytes]:
        return self.link.written[1:]


@asynccontextmanager
async def talking(script: Script) -> AsyncGenerator[Talk]:
    talk = Talk(script)
    await talk.conversation.open()
    streaming = asyncio.create_task(talk.conversation.stream(talk.hear))
    yield talk
    streaming.cancel()
    await asyncio.wait({streaming})
    await talk.conversation.close()
    assert talk.link.closed
    assert talk.link.written[-1] == messages.STOP_STREAMING


def usual(command: bytes) -> bytes:
    return ANSWERS.get(command, ACK)


async def test_questions_and_settings_are_answered() -> None:
    async with talking(usual) as talk:
        ask = talk.conversation.ask
        assert await ask(messages.GET_HARDWARE, Hardware) == Hardware(3)
        assert await ask(messages.GET_FIRMWARE, Firmware) == Firmware(3, (0, 16, 11))
        await talk.conversation.tell(SET_RATE)
        assert await ask(messages.GET_STATUS, Status) == Status(StatusFlag.STREAMING)
    assert talk.asked[:-1] == [
        messages.GET_HARDWARE, messages.GET_FIRMWARE, SET_RATE, messages.GET_STATUS
    ]  # fmt: skip


async def test_an_unasked_status_answers_no_command() -> None:
    async with talking(lambda command: UNASKED + usual(command)) as talk:
        await talk.conversation.tell(SET_RATE)
        assert await talk.conversation.ask(messages.GET_HARDWARE, Hardware) == Hardware(3)
    assert [message for message, _ in talk.heard] == [
        Status(StatusFlag.DOCKED), Ack(), Status(StatusFlag.DOCKED), Hardware(3)
    ]  # fmt: skip


async def test_an_unasked_status_alone_leaves_a_setting_unanswered() -> None:
    def script(command: bytes) -> bytes:
        return UNASKED if command == SET_RATE else usual(command)

    async with talking(script) as talk:
        with pytest.raises(ProtocolError) as caught:
            await talk.conversation.tell(SET_RATE)
    assert caught.value.reason is ProtocolReason.NO_REPLY


async def test_a_refusal_is_told() -> None:
    async with talking(lambda _: NACK) as talk:
        with pytest.raises(ProtocolError, match="refuses command 0x05") as caught:
            await talk.conversation.tell(SET_RATE)
    assert caught.value.reason is ProtocolReason.REFUSED


class Late:
    """Keeps back the answers to the first of a command, and sends them with a later one."""

    def __init__(self, command: bytes, release_with: bytes) -> None:
        self._command, self._release_with = command, release_with
        self._owed = b""
        self.ignored: set[bytes] = set()

    def __call__(self, command: bytes) -> bytes:
        if command == self._command and command not in self.ignored:
            self.ignored.add(command)
            self._owed += usual(command)
            return b""
        answer = usual(command)
        if command == self._release_with:
            answer, self._owed = self._owed + answer, b""
        return answer


async def test_a_late_answer_does_not_pass_for_the_next_one() -> None:
    other = messages.set_gsr_range(4)
    late = Late(SET_RATE, messages.GET_HARDWARE)

    def script(command: bytes) -> bytes:
        # This one is lost; an answer that was owed would be taken for its own.
        return b"" if command == other else late(command)

    async with talking(script) as talk:
        await talk.conversation.tell(SET_RATE)
        with pytest.raises(ProtocolError) as caught:
            await talk.conversation.tell(other)
    assert caught.value.reason is ProtocolReason.NO_REPLY
    assert talk.asked.count(SET_RATE) == 2


async def test_nothing_is_asked_again_before_the_device_is_in_step() -> None:
    def script(command: bytes) -> bytes:
        silent = {SET_RATE, messages.TEST_CONNECTION, messages.GET_HARDWARE, messages.GET_FIRMWARE}
        return b"" if command in silent and talk.asked.count(SET_RATE) < 2 else usual(command)

    async with talking(script) as talk:
        await talk.conversation.tell(SET_RATE)
    assert talk.asked[:-1] == [
        SET_RATE,
        messages.TEST_CONNECTION, messages.GET_HARDWARE,
        messages.TEST_CONNECTION, messages.GET_FIRMWARE,
        messages.TEST_CONNECTION, messages.GET_EXPANSION_POWER,
        SET_RATE,
    ]  # fmt: skip


async def test_a_late_answer_to_the_question_itself_does_not_end_the_resynchronisation() -> None:
    late = Late(messages.GET_HARDWARE, messages.TEST_CONNECTION)
    async with talking(late) as talk:
        assert await talk.conversation.ask(messages.GET_HARDWARE, Hardware) == Hardware(3)
        assert await talk.conversation.ask(
            messages.GET_EXPANSION_POWER, ExpansionPower
        ) == ExpansionPower(True)
    assert talk.asked[:4] == [
        messages.GET_HARDWARE, messages.TEST_CONNECTION, messages.GET_FIRMWARE,
        messages.GET_HARDWARE,
    ]  # fmt: skip


async def test_a_device_that_says_nothing_is_silent() -> None:
    async with talking(lambda _: b"") as talk:
        with pytest.raises(TransportError) as caught:
            await talk.conversation.ask(messages.GET_HARDWARE, Hardware)
    assert caught.value.reason is TransportReason.SILENT
    assert talk.asked.count(messages.TEST_CONNECTION) == 3


async def test_another_device_on_the_port_is_no_shimmer() -> None:
    async with talking(lambda _: b"$GPGGA,12") as talk:
        with pytest.raises(ProtocolError, match="not a Shimmer") as caught:
            await talk.conversation.ask(messages.GET_HARDWARE, Hardware)
    assert caught.value.reason is ProtocolReason.GARBAGE


async def test_a_cut_ends_a_question_and_all_that_follow() -> None:
    def script(command: bytes) -> bytes | None:
        return None if command == messages.GET_HARDWARE else usual(command)

    async with talking(script) as talk:
        for _ in range(2):
            with pytest.raises(TransportError) as caught:
                await talk.conversation.ask(messages.GET_HARDWARE, Hardware)
            assert caught.value.reason is TransportReason.LOST
        with pytest.raises(TransportError):
            await talk.conversation.stream(talk.hear)
    assert talk.asked.count(messages.GET_HARDWARE) == 1


async def test_checksums_begin_with_the_answer_that_accepts_them() -> None:
    crc = CrcMode.OFF

    def script(command: bytes) -> bytes:
        nonlocal crc
        crc = CrcMode.FULL if command == messages.set_crc(CrcMode.FULL) else crc
        return usual(command) + checksum(usual(command), crc)

    async with talking(script) as talk:
        await talk.conversation.use_crc(CrcMode.FULL)
        assert await talk.conversation.ask(messages.GET_HARDWARE, Hardware) == Hardware(3)
    assert talk.conversation.dropped_bytes == 0


async def test_data_may_come_between_a_question_and_its_answer() -> None:
    data = b"\0\0\1\0\1\2\3\4"
    packets = data + b"\0\0\2\0\5\6\7\x08"

    def script(command: bytes) -> bytes:
        return packets + usual(command) if command == messages.GET_STATUS else usual(command)

    async with talking(script) as talk:
        await talk.conversation.start_streaming(Layout([0x12, 0x1C]), 256)
        status = await talk.conversation.poll(messages.GET_STATUS, Status)
    assert status == Status(StatusFlag.STREAMING)
    assert [message for message, _ in talk.heard if isinstance(message, Packet)] == [
        Packet(256, (0x0201, 0x0403)), Packet(512, (0x0605, 0x0807))
    ]  # fmt: skip


async def test_a_poll_that_is_not_answered_or_refused_has_no_answer() -> None:
    answer = b""
    async with talking(lambda command: answer) as talk:
        assert await talk.conversation.poll(messages.GET_STATUS, Status) is None
        answer = NACK
        assert await talk.conversation.poll(messages.GET_STATUS, Status) is None
    assert talk.asked.count(messages.TEST_CONNECTION) == 0


async def test_a_device_that_was_left_streaming_is_stopped_and_its_data_thrown_away() -> None:
    talk = Talk(lambda command: b"" if command == messages.STOP_STREAMING else usual(command))
    before = LSL_CLOCK()
    talk.link.send(bytes(100))
    until_s = await talk.conversation.open()
    assert until_s is not None
    assert before <= until_s <= LSL_CLOCK()
    assert talk.heard == []
    assert await talk.conversation.ask(messages.GET_HARDWARE, Hardware) == Hardware(3)
    await talk.conversation.close()


async def test_a_device_that_does_not_stop_is_told_three_times() -> None:
    talk = Talk(usual)

    async def stream() -> None:
        while True:
            talk.link.send(bytes(8))
            await asyncio.sleep(0.01)

    streaming = asyncio.create_task(stream())
    assert await talk.conversation.open() is not None
    streaming.cancel()
    assert talk.link.written == [messages.STOP_STREAMING] * 3
    await talk.conversation.close()
