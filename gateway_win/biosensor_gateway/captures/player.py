"""Plays what passed over a device's links, in step with the driver that asks.

What came from the device comes again at the same time after the connection as then, but not
before the driver has asked for what it was asked for by then: an answer never comes before its
question. A driver that asks in another way than the one that recorded gets what fits best, and
what it asks besides is counted.
"""

from __future__ import annotations

import asyncio
import json
import math
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, cast

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.captures.file import Capture, Event
from biosensor_gateway.system.clock import Clock
from biosensor_gateway.transports.deadlines import in_background
from biosensor_gateway.transports.link import Received
from biosensor_gateway.transports.tap import ASKED, What

HOLD_S = 5.0
"""So long the device waits for something that it was asked for then, and is not asked for now."""
EARLY_S = 4.0
"""So long an answer waits for its time; less than drivers wait for it."""
OPEN_LIMIT_S = 15.0
_BY_DRIVER = ASKED | {What.SENT}
_FREE = frozenset({What.READ, What.UNSUBSCRIBED, What.PAIRED})
"""Nothing that the device sends by itself depends on them."""


class Asked:
    """Something that the device was asked for then."""

    def __init__(self, event: Event) -> None:
        self.event = event
        self.key = event.what, event.at, event.data
        self.is_asked = False
        self.is_reached = asyncio.Event()


class Deck:
    """Plays one connection, from its making on.

    Parameters
    ----------
    events
        Its own, the first one its opening.
    clock
    shift_s
        From the capture's time to the clock's.
    deliver
        Gets what comes from the device, and the loss of the link.

    Attributes
    ----------
    shift_s
        It has grown by what the driver took longer than then.
    unknown
        How often it was asked for what it was not asked for then, by kind and characteristic.
    unasked
        How often it was not asked for what it was asked for then.
    """

    def __init__(
        self,
        events: Sequence[Event],
        clock: Clock,
        shift_s: float,
        deliver: Callable[[Event], None],
    ) -> None:
        self._clock, self._deliver = clock, deliver
        self.shift_s = shift_s
        self.unknown: Counter[tuple[str, str]] = Counter()
        self.unasked: Counter[tuple[str, str]] = Counter()
        self._items: list[Event | Asked] = []
        # A driver that does without keeping the device awake is waited for once, not each time.
        self._given_up: set[tuple[What, str, str]] = set()
        for event in events:
            if event.what in _BY_DRIVER and not event.is_cancelled:
                self._items.append(Asked(event))
            elif event.what in (What.CAME, What.LOST):
                self._items.append(event)
        self._open = [each for each in self._items if isinstance(each, Asked)]
        # Requests of JSON-RPC, by their numbers then.
        self._numbers: dict[object, object] = {}
        self._news = asyncio.Event()
        self.is_over = asyncio.Event()
        self._playing = in_background(self._play())

    async def ask(self, what: What, at: str = "", data: bytes = b"") -> Event | None:
        """Do what a driver asks for; return how it went then, None if it was not asked then."""
        asked = self._take(what, at, data)
        if asked is None:
            return None  # nothing is dropped: it is counted in `unknown`
        if what is not What.READ:
            with suppress(TimeoutError):  # nothing is dropped: it is answered early instead
                async with asyncio.timeout(EARLY_S):
                    await asked.is_reached.wait()
        await asyncio.sleep(asked.event.took)
        return asked.event

    def tell(self, data: bytes, at: str = "") -> None:
        """Take what a driver sends without waiting."""
        self._take(What.SENT, at, data)

    def stop(self) -> None:
        """Play no more."""
        self._playing.cancel()
        self.is_over.set()

    def _take(self, what: What, at: str, data: bytes) -> Asked | None:
        fitting = [each for each in self._open if (each.event.what, each.event.at) == (what, at)]
        exact = [each for each in fitting if what is What.READ or each.event.bytes == data]
        request = parsed(data) if what is What.SENT else {}
        if "method" in request:
            # By its number alone it is another one each time; none answers another's question.
            fitting = [
                each
                for each in fitting
                if parsed(each.event.bytes).get("method") == request["method"]
            ]
        found = next(iter(exact or fitting), None)
        if found is None:
            # What is asked behind the end, nobody can have asked then.
            self.unknown[what.value, at] += not self.is_over.is_set()
            return None  # nothing is dropped: it is counted in `unknown`
        self._open.remove(found)
        if "id" in request:
            self._numbers[_number(parsed(found.event.bytes))] = request["id"]
        found.is_asked = True
        self._news.set()
        return found

    async def _play(self) -> None:
        for item in self._items:
            event = item.event if isinstance(item, Asked) else item
            await asyncio.sleep(max(0.0, event.t + self.shift_s - self._clock()))
            if isinstance(item, Asked):
                await self._hold(item)
                item.is_reached.set()
            else:
                self._deliver(self._answering(event))
        self.is_over.set()

    def _answering(self, event: Event) -> Event:
        """Give an answer the number of the request that was made now."""
        if not self._numbers or not event.bytes.startswith(b"{"):
            return event
        message = parsed(event.bytes)
        number = _number(message)
        if self._numbers.get(number, number) == number:
            return event
        data = json.dumps(message | {"id": self._numbers[number]}).encode()
        return event.model_copy(update={"data": data.hex()})

    async def _hold(self, asked: Asked) -> None:
        """Stop until it is asked for; not for what nothing depends on, nor if others are."""
        if asked.is_asked or not self._holds(asked):
            return  # nothing is dropped: nothing waits for it
        begun_s = self._clock()
        with suppress(TimeoutError):  # nothing is dropped: it goes on late, and says so
            async with asyncio.timeout(HOLD_S):
                while not asked.is_asked and not self._is_passed_over(asked):
                    self._news.clear()
                    await self._news.wait()
        self.shift_s += self._clock() - begun_s
        if not asked.is_asked:
            self._given_up.add(asked.key)
            self.unasked[asked.event.what.value, asked.event.at] += 1

    def _holds(self, asked: Asked) -> bool:
        return asked.event.what not in _FREE and asked.key not in self._given_up

    def _is_passed_over(self, asked: Asked) -> bool:
        """Whether the driver waits for something else that comes later."""
        behind = self._items[self._items.index(asked) + 1 :]
        questions = [each for each in behind if isinstance(each, Asked) and self._holds(each)]
        return any(each.is_asked for each in questions)


def parsed(data: bytes) -> dict[str, Any]:
    """Return a message of JSON-RPC, empty if it is something else."""
    try:
        message: object = json.loads(data)
    except (ValueError, RecursionError):  # nothing is dropped: it is no message of JSON-RPC
        return {}  # nothing is dropped: what is no message is compared as bytes
    return cast("dict[str, Any]", message) if isinstance(message, dict) else {}


def _number(message: dict[str, Any]) -> object:
    number = message.get("id")
    return number if isinstance(number, int | str) else None


class Player:
    """The connections of a capture, one after the other.

    Attributes
    ----------
    decks
        Those that were opened.
    unheard
        How much came that the driver had not subscribed to.
    """

    def __init__(self, capture: Capture, clock: Clock) -> None:
        self._links = capture.of_links()
        self._clock = clock
        self.decks: list[Deck] = []
        self._is_opened = asyncio.Event()
        self.unheard = 0

    @property
    def next_opening(self) -> Event:
        """The next connection's, of the last one where there is no other."""
        return self._links[min(len(self.decks), len(self._links) - 1)][0]

    @property
    def rest_s(self) -> float:
        """How long it takes until the next connection can be made [s]; inf after the last one."""
        number = len(self.decks)
        if number >= len(self._links):
            return math.inf
        if not number:
            return 0.0
        due_s = self._links[number][0].t + self.decks[-1].shift_s
        return max(0.0, due_s - self._clock())

    async def open(self, deliver: Callable[[Event], None]) -> Deck:
        """Make the next connection, when its time has come.

        Raises
        ------
        TransportError
            ``ABSENT``: that takes too long, or there is none.
        """
        if self.rest_s > OPEN_LIMIT_S:
            message = "the device of the capture is not there now"
            raise TransportError(TransportReason.ABSENT, message)
        await asyncio.sleep(self.rest_s)
        events = self._links[len(self.decks)]
        shift_s = self._clock() - events[0].t
        self.decks.append(Deck(events, self._clock, shift_s, deliver))
        self._is_opened.set()
        return self.decks[-1]

    async def played(self) -> None:
        """Wait until the last connection has been played."""
        while len(self.decks) < len(self._links):
            self._is_opened.clear()
            await self._is_opened.wait()
        await self.decks[-1].is_over.wait()


class ReplayedLink:
    """A :class:`~biosensor_gateway.transports.link.ByteLink` that a capture is played on."""

    def __init__(self, player: Player, clock: Clock) -> None:
        self._player, self._clock = player, clock
        self._deck: Deck | None = None
        self._came: asyncio.Queue[Received | None] = asyncio.Queue()

    async def open(self) -> None:
        """Make the next connection of the capture."""
        self._deck = await self._player.open(self._deliver)

    async def read(self) -> Received:
        """Wait for the next bytes; raise ``LOST`` where the link was lost then."""
        received = await self._came.get()
        if received is None:
            self._came.put_nowait(None)
            message = "the link was cut, as in the capture"
            raise TransportError(TransportReason.LOST, message)
        return received

    def write(self, data: bytes) -> None:
        """Send without waiting."""
        if self._deck is not None:
            self._deck.tell(data)

    async def close(self) -> None:
        """End the connection."""
        if self._deck is not None:
            self._deck.stop()

    def _deliver(self, event: Event) -> None:
        is_loss = event.what is What.LOST
        self._came.put_nowait(None if is_loss else Received(event.bytes, self._clock()))
