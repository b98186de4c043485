"""Questions, answers and data on one link: who gets what, in which order, and when it ends."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Sequence

import pytest

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.transports import dialogue as dialogue_module
from biosensor_gateway.transports.dialogue import Dialogue

LONG_S = 20.0
REFUSED = TransportError(TransportReason.SILENT, "not taken")
CUT = TransportError(TransportReason.LOST, "cut")


class Device:
    """Answers each command as its script says; a word is one read, and an error the end."""

    def __init__(self) -> None:
        self.script: dict[str, str] = {}
        self.sent: list[str] = []
        self.heard: list[str] = []
        self._incoming: asyncio.Queue[str | Exception] = asyncio.Queue()
        self.dialogue = Dialogue(self._receive, self._send)

    def say(self, *words: str | Exception) -> None:
        for word in words:
            self._incoming.put_nowait(word)

    def hear(self, words: Sequence[str]) -> None:
        self.heard += words

    async def ask(self, command: str, limit_s: float = LONG_S) -> str | None:
        return await self.dialogue.ask(
            command, lambda word: word if word.startswith(command) else None, limit_s
        )

    async def _receive(self) -> list[str]:
        word = await self._incoming.get()
        if isinstance(word, Exception):
            raise word
        return [word]

    async def _send(self, command: str) -> None:
        if command == "refused":
            raise REFUSED
        self.sent.append(command)
        self.say(*self.script.get(command, "").split())


@pytest.fixture
async def device() -> AsyncGenerator[Device]:
    made = Device()
    made.dialogue.begin()
    yield made
    await made.dialogue.close()


async def settle() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


async def test_all_that_comes_is_heard_in_order_also_before_somebody_listens(
    device: Device,
) -> None:
    device.say("data1")
    device.script = {"rate": "data2 rate50 data3"}
    assert await device.ask("rate") == "rate50"
    await settle()
    streaming = asyncio.create_task(device.dialogue.stream(device.hear))
    await settle()
    device.say("data4")
    await settle()
    assert device.heard == ["data1", "data2", "rate50", "data3", "data4"]
    streaming.cancel()
    await asyncio.wait({streaming})
    device.say("data5")
    await settle()
    assert "data5" not in device.heard


async def test_an_answer_that_comes_too_late_does_not_answer_the_next_question(
    device: Device,
) -> None:
    assert await device.ask("rate", 0.01) is None
    device.say("rate0")
    device.script = {"rate": "rate50"}
    assert await device.ask("rate") == "rate50"


async def test_what_an_answer_changes_holds_for_what_comes_behind_it(device: Device) -> None:
    notes: list[str] = []

    def match(word: str) -> str | None:
        notes.append(word)
        return word if word == "started" else None

    streaming = asyncio.create_task(device.dialogue.stream(notes.extend))
    device.script = {"start": "started data1"}
    await device.dialogue.ask("start", match, LONG_S)
    await settle()
    assert notes == ["started", "started", "data1"]
    streaming.cancel()


async def test_questions_take_turns(device: Device) -> None:
    first = asyncio.create_task(device.ask("a"))
    second = asyncio.create_task(device.ask("b"))
    await settle()
    assert device.sent == ["a"]
    device.say("b0", "a1")
    await settle()
    assert device.sent == ["a", "b"]
    device.say("b1")
    assert (await first, await second) == ("a1", "b1")


async def test_the_end_of_the_link_reaches_who_asks_who_listens_and_who_asks_later(
    device: Device,
) -> None:
    streaming = asyncio.create_task(device.dialogue.stream(device.hear))
    asking = asyncio.create_task(device.ask("rate"))
    await settle()
    device.say("data1", CUT)
    for waiting in (streaming, asking):
        with pytest.raises(TransportError) as caught:
            await waiting
        assert caught.value is CUT
    with pytest.raises(TransportError):
        await device.ask("rate")
    assert device.sent == ["rate"]
    assert device.heard == ["data1"]


async def test_what_arrived_before_the_end_is_heard(device: Device) -> None:
    device.say("data1", CUT)
    await settle()
    with pytest.raises(TransportError):
        await device.dialogue.stream(device.hear)
    assert device.heard == ["data1"]


async def test_a_listener_that_fails_ends_the_dialogue(device: Device) -> None:
    def fail(words: Sequence[str]) -> None:
        raise ValueError(words)

    streaming = asyncio.create_task(device.dialogue.stream(fail))
    await settle()
    device.say("data1")
    with pytest.raises(ValueError, match="data1"):
        await streaming


async def test_a_command_that_cannot_be_sent_is_no_question(device: Device) -> None:
    with pytest.raises(TransportError) as caught:
        await device.ask("refused")
    assert caught.value is REFUSED
    device.script = {"rate": "refused rate50"}
    assert await device.ask("rate") == "rate50"


async def test_nobody_who_never_listens_lets_the_memory_overflow(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(dialogue_module, "KEPT_READS", 2)
    device = Device()
    device.dialogue.begin()
    device.say("data1", "data2", "data3", CUT)
    await settle()
    with pytest.raises(TransportError):
        await device.dialogue.stream(device.hear)
    assert device.heard == ["data1", "data2"]


async def test_a_question_before_the_beginning_is_a_mistake() -> None:
    with pytest.raises(RuntimeError, match="started"):
        await Device().ask("rate")
