"""Plays the captured links of a device, in step with the requests of a driver.

The device's data are played at their captured times after the connection, but not before the driver
has made the requests that preceded them in the capture: an answer never comes before its request. A
driver whose requests differ from the captured ones gets the answers that fit best, and requests
without an answer are counted.
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
from biosensor_gateway.transports.link import Address, Received
from biosensor_gateway.transports.ports import ASKING, CONTROL, DATA, Take
from biosensor_gateway.transports.tap import ASKED, What
from biosensor_gateway.transports.threads import in_background

HOLD_S = 5.0
"""How long the player waits for a captured request that the driver does not make."""
EARLY_S = 4.0
"""How long an answer is delayed at most to its captured time; less than drivers wait for it."""
OPEN_LIMIT_S = 15.0
_BY_DRIVER = ASKED | {What.SENT}
_FREE = frozenset({What.READ, What.UNSUBSCRIBED, What.PAIRED})
"""Requests on which no data of the device depend."""


class CapturedRequest:
    """A request in the capture."""

    def __init__(self, event: Event) -> None:
        self.event = event
        self.key = event.what, event.at, event.data
        self.is_asked = False
        self.is_reached = asyncio.Event()


class LinkPlayer:
    """Plays one connection, which begins when this is made.

    Parameters
    ----------
    events
        Events of the connection; the first is its opening.
    shift_s
        Offset from the capture's time to the clock.
    deliver
        Called with the device's data, and with the loss of the link.
    """

    def __init__(
        self,
        events: Sequence[Event],
        clock: Clock,
        shift_s: float,
        deliver: Callable[[Event], None],
    ) -> None:
        self._clock, self._deliver = clock, deliver
        self.shift_s = shift_s  # Grows while the driver is slower than the captured one.
        # Number of requests that are not in the capture, by kind and characteristic.
        self.unknown: Counter[tuple[str, str]] = Counter()
        # Number of captured requests that the driver did not make, by kind and characteristic.
        self.unasked: Counter[tuple[str, str]] = Counter()
        self._items: list[Event | CapturedRequest] = []
        # A repeated request that the driver does not make, such as a keep-alive, delays only once.
        self._given_up: set[tuple[What, str, str]] = set()
        for event in events:
            if event.what in _BY_DRIVER and not event.is_cancelled:
                self._items.append(CapturedRequest(event))
            elif event.what in (What.CAME, What.LOST):
                self._items.append(event)
        self._open = [each for each in self._items if isinstance(each, CapturedRequest)]
        # Numbers of the driver's JSON-RPC requests, by the captured numbers.
        self._numbers: dict[object, object] = {}
        self._news = asyncio.Event()
        self.is_over = asyncio.Event()
        self._playing = in_background(self._play())

    async def ask(self, what: What, at: str = "", data: bytes = b"") -> Event | None:
        """Answer a driver's request with the captured event; None if there is none."""
        asked = self._take(what, at, data)
        if asked is None:
            return None  # nothing is dropped: it is counted in `unknown`
        if what is not What.READ:
            with suppress(TimeoutError):  # nothing is dropped: it is answered early instead
                async with asyncio.timeout(EARLY_S):
                    await asked.is_reached.wait()
        await asyncio.sleep(asked.event.took)
        return asked.event

    def send(self, data: bytes, at: str = "") -> None:
        """Take data that a driver sends without waiting for an answer."""
        self._take(What.SENT, at, data)

    def stop(self) -> None:
        """Stop playing."""
        self._playing.cancel()
        self.is_over.set()

    def _take(self, what: What, at: str, data: bytes) -> CapturedRequest | None:
        fitting = [each for each in self._open if (each.event.what, each.event.at) == (what, at)]
        exact = [each for each in fitting if what is What.READ or each.event.bytes == data]
        request = parsed(data) if what is What.SENT else {}
        if "method" in request:
            # Compared by method, because the number in a request differs each time.
            fitting = [
                each
                for each in fitting
                if parsed(each.event.bytes).get("method") == request["method"]
            ]
        found = next(iter(exact or fitting), None)
        if found is None:
            # Requests after the end of the capture cannot be in it, and are not counted.
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
            event = item.event if isinstance(item, CapturedRequest) else item
            await asyncio.sleep(max(0.0, event.t + self.shift_s - self._clock()))
            if isinstance(item, CapturedRequest):
                await self._hold(item)
                item.is_reached.set()
            else:
                self._deliver(self._answering(event))
        self.is_over.set()

    def _answering(self, event: Event) -> Event:
        """Replace the captured number in an answer by that of the driver's request."""
        if not self._numbers or not event.bytes.startswith(b"{"):
            return event
        message = parsed(event.bytes)
        number = _number(message)
        if self._numbers.get(number, number) == number:
            return event
        data = json.dumps(message | {"id": self._numbers[number]}).encode()
        return event.model_copy(update={"data": data.hex()})

    async def _hold(self, asked: CapturedRequest) -> None:
        """Wait for a request on which data depend, unless the driver makes later ones first."""
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

    def _holds(self, asked: CapturedRequest) -> bool:
        return asked.event.what not in _FREE and asked.key not in self._given_up

    def _is_passed_over(self, asked: CapturedRequest) -> bool:
        """Whether the driver has made a request that comes later in the capture."""
        behind = self._items[self._items.index(asked) + 1 :]
        questions = [
            each for each in behind if isinstance(each, CapturedRequest) and self._holds(each)
        ]
        return any(each.is_asked for each in questions)


def parsed(data: bytes) -> dict[str, Any]:
    """Return a JSON-RPC message; empty if the data are something else."""
    try:
        message: object = json.loads(data)
    except (ValueError, RecursionError):  # nothing is dropped: it is not JSON-RPC
        return {}  # nothing is dropped: other data is compared as bytes
    return cast("dict[str, Any]", message) if isinstance(message, dict) else {}


def _number(message: dict[str, Any]) -> object:
    number = message.get("id")
    return number if isinstance(number, int | str) else None


class Player:
    """Plays the connections of a capture, one after the other."""

    def __init__(self, capture: Capture, clock: Clock) -> None:
        self._captured = capture.of_links()
        self._clock = clock
        self.links: list[LinkPlayer] = []  # The connections that were opened.
        self._is_opened = asyncio.Event()
        self.unheard = 0  # Number of packets to which the driver had not subscribed.

    @property
    def next_opening(self) -> Event:
        """Opening of the next connection, or of the last one if there is no next."""
        return self._captured[min(len(self.links), len(self._captured) - 1)][0]

    @property
    def rest_s(self) -> float:
        """Time until the next connection can be made [s]; inf after the last one."""
        number = len(self.links)
        if number >= len(self._captured):
            return math.inf
        if not number:
            return 0.0
        opening_s = self._captured[number][0].t + self.links[-1].shift_s
        return max(0.0, opening_s - self._clock())

    async def open(self, deliver: Callable[[Event], None]) -> LinkPlayer:
        """Make the next connection, at its captured time.

        Raises
        ------
        TransportError
            ``ABSENT`` if that takes too long, or there is no next connection.
        """
        if self.rest_s > OPEN_LIMIT_S:
            message = "the device of the capture is not present now"
            raise TransportError(TransportReason.ABSENT, message)
        await asyncio.sleep(self.rest_s)
        events = self._captured[len(self.links)]
        shift_s = self._clock() - events[0].t
        self.links.append(LinkPlayer(events, self._clock, shift_s, deliver))
        self._is_opened.set()
        return self.links[-1]

    async def played(self) -> None:
        """Wait until the last connection has been played."""
        while len(self.links) < len(self._captured):
            self._is_opened.clear()
            await self._is_opened.wait()
        await self.links[-1].is_over.wait()


class ReplayedLink:
    """A :class:`~biosensor_gateway.transports.link.ByteLink` that plays a capture."""

    def __init__(self, player: Player, clock: Clock) -> None:
        self._player, self._clock = player, clock
        self._link: LinkPlayer | None = None
        self._came: asyncio.Queue[Received | None] = asyncio.Queue()

    async def open(self) -> None:
        """Make the next connection of the capture."""
        self._link = await self._player.open(self._deliver)

    async def read(self) -> Received:
        """Wait for the next bytes; raises ``LOST`` where the captured link was lost."""
        received = await self._came.get()
        if received is None:
            self._came.put_nowait(None)
            message = "the link was cut, as in the capture"
            raise TransportError(TransportReason.LOST, message)
        return received

    def write(self, data: bytes) -> None:
        """Send without waiting."""
        if self._link is not None:
            self._link.send(data)

    async def close(self) -> None:
        """End the connection."""
        if self._link is not None:
            self._link.stop()

    def _deliver(self, event: Event) -> None:
        is_loss = event.what is What.LOST
        self._came.put_nowait(None if is_loss else Received(event.bytes, self._clock()))


_DEVICE: Address = ("192.0.2.1", 3131)
"""An address reserved for documentation, which no host has."""
_HERE = "192.0.2.2"
_ACCEPTING_NUMBER, _DATA_NUMBER = 3132, 3133


class ReplayedPorts:
    """A :class:`~biosensor_gateway.transports.ports.Ports` that plays a capture."""

    def __init__(self, player: Player, clock: Clock) -> None:
        self._player, self._clock = player, clock
        self._answered: Callable[[bytes, Address], None] | None = None
        self._made: Callable[[], asyncio.Protocol] | None = None
        self._controlled: asyncio.Protocol | None = None
        self._take: Take | None = None

    async def asking(self, take: Callable[[bytes, Address], None]) -> _Asking:
        """Make the next connection of the capture."""
        self._answered = take
        return _Asking(await self._player.open(self._deliver))

    def towards(self, host: str) -> str:
        """Return an address for this computer."""
        del host
        return _HERE

    async def accepting(self, made: Callable[[], asyncio.Protocol], here: str) -> _Accepting:
        """Let the device connect at its captured time."""
        del here
        self._made = made
        return _Accepting()

    def data(self, here: str) -> _DataPort:
        """Return a port that receives data at their captured times."""
        del here
        return _DataPort(self._player.links[-1], self._listen)

    def _listen(self, take: Take) -> None:
        self._take = take

    def _deliver(self, event: Event) -> None:
        if event.what is What.LOST:
            if self._controlled is not None:
                self._controlled.connection_lost(None)
        elif event.at == CONTROL and self._made is not None:
            self._controlled = self._made()
            self._controlled.connection_made(_Control(self._player.links[-1]))
        elif event.at == DATA and self._take is not None:
            self._take(event.bytes, self._clock(), _DEVICE)
        elif event.at == ASKING and self._answered is not None:
            self._answered(event.bytes, _DEVICE)
        else:
            self._player.unheard += 1


class _Asking(asyncio.DatagramTransport):
    def __init__(self, link: LinkPlayer) -> None:
        super().__init__()
        self._link = link

    def sendto(self, data: Any, addr: Any = None) -> None:  # noqa: ANN401 - as in asyncio
        del addr
        self._link.send(data, ASKING)

    def close(self) -> None:
        self._link.stop()


class _Accepting:
    number = _ACCEPTING_NUMBER

    def close(self) -> None:
        """Do nothing: nothing is open."""


class _Control(asyncio.Transport):
    """The connection from the device."""

    def __init__(self, link: LinkPlayer) -> None:
        super().__init__({"peername": _DEVICE})
        self._link = link
        self._is_closing = False

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self._link.send(bytes(data), CONTROL)

    def is_closing(self) -> bool:
        return self._is_closing

    def close(self) -> None:
        self._is_closing = True


class _DataPort:
    number = _DATA_NUMBER

    def __init__(self, link: LinkPlayer, listen: Callable[[Take], None]) -> None:
        self._link, self._listen = link, listen

    def send(self, data: bytes, to: Address) -> None:
        del to
        self._link.send(data, DATA)

    def listen(self, take: Take, lost: Callable[[OSError], object]) -> None:
        del lost
        self._listen(take)

    def end(self) -> None:
        """Do nothing: nothing is open."""
