"""A capture is played in step with the driver: no answer comes before its question."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from biosensor_gateway.captures.file import Event
from biosensor_gateway.captures.player import HOLD_S, LinkPlayer
from biosensor_gateway.system.clock import LeapingClock
from biosensor_gateway.transports.tap import CANCELLED, What

AT = "0000aaaa-0000-1000-8000-00805f9b34fb"
QUESTION, ANSWER = "01", "f001"


def event(t: float, what: What, data: str = "", **more: object) -> Event:
    return Event.model_validate({"t": t, "link": 0, "what": what, "at": AT, "data": data, **more})


TAPE = (
    event(0.0, What.OPENED),
    event(0.5, What.WRITTEN, QUESTION, took=0.1),
    event(0.6, What.CAME, ANSWER),
    event(1.0, What.READ, "64", took=0.2),
    event(1.5, What.CAME, "aa"),
    event(2.0, What.WRITTEN, "ee"),
    event(2.5, What.CAME, "bb"),
    event(4.0, What.WRITTEN, "ee"),
    event(4.5, What.CAME, "cc"),
)


def played(
    talk: Callable[[LinkPlayer], Awaitable[object]], tape: tuple[Event, ...] = TAPE
) -> tuple[list[tuple[float, str]], LinkPlayer]:
    """Play to somebody; return what came, each with its time."""
    clock, heard = LeapingClock(100.0), list[tuple[float, str]]()

    async def play() -> LinkPlayer:
        link = LinkPlayer(
            tape, clock, 100.0, lambda each: heard.append((clock() - 100.0, each.data))
        )
        await talk(link)
        await link.is_over.wait()
        return link

    with asyncio.Runner(loop_factory=clock.new_event_loop) as runner:
        link = runner.run(play())
    return [(round(t, 3), data) for t, data in heard], link


async def as_then(link: LinkPlayer) -> None:
    await asyncio.sleep(0.5)
    await link.ask(What.WRITTEN, AT, b"\x01")
    await asyncio.sleep(0.4)
    answer = await link.ask(What.READ, AT)
    assert answer is not None
    assert answer.bytes == b"\x64"
    for _ in range(2):
        await asyncio.sleep(0.8)
        await link.ask(What.WRITTEN, AT, b"\xee")
        await asyncio.sleep(1.2)


def test_who_asks_as_then_hears_all_at_its_time() -> None:
    heard, link = played(as_then)
    assert heard == [(0.6, ANSWER), (1.5, "aa"), (2.5, "bb"), (4.5, "cc")]
    assert (link.unknown, link.unasked) == ({}, {})


def test_no_answer_comes_before_its_question() -> None:
    async def late(link: LinkPlayer) -> None:
        await asyncio.sleep(3.0)
        await link.ask(What.WRITTEN, AT, b"\x01")

    heard, link = played(late)
    assert heard[0] == (3.1, ANSWER)
    # What follows keeps its distance.
    assert heard[1] == (4.0, "aa")
    # The keeping awake is waited for once, not each time.
    assert [t for t, _ in heard[2:]] == [5.0 + HOLD_S, 7.0 + HOLD_S]
    assert link.unasked == {("written", AT): 1}


def test_who_asks_too_early_waits_for_the_time_of_then() -> None:
    async def early(link: LinkPlayer) -> None:
        await link.ask(What.WRITTEN, AT, b"\x01")

    assert played(early)[0][0] == (0.6, ANSWER)


def test_a_question_that_was_not_asked_then_is_counted() -> None:
    other = AT.replace("aaaa", "bbbb")

    async def restarted(link: LinkPlayer) -> None:
        assert await link.ask(What.READ, other) is None
        await as_then(link)

    heard, link = played(restarted)
    assert link.unknown == {("read", other): 1}
    assert len(heard) == 4


def test_a_question_in_other_words_gets_the_answer_of_then() -> None:
    async def in_other_words(link: LinkPlayer) -> None:
        await link.ask(What.WRITTEN, AT, b"\x01\x05")

    heard, link = played(in_other_words)
    assert heard[0] == (0.6, ANSWER)
    assert not link.unknown


def test_what_the_driver_gave_up_then_is_no_question() -> None:
    given_up = event(0.5, What.WRITTEN, QUESTION, error=CANCELLED)
    tape = (TAPE[0], given_up, event(1.0, What.CAME, "aa"))

    async def silent(_link: LinkPlayer) -> None:
        pass

    assert played(silent, tape)[0] == [(1.0, "aa")]
