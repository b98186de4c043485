"""Observes or replaces the links of a device, to capture and replay its data.

Drivers do not know of it, except for one whose device connects to ports of this computer. A link
checks on creation whether there is a tap or a replacement; :func:`tapped` or :func:`replaced` set
one in the context in which the driver runs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, NamedTuple, Protocol, TypeVar

from biosensor_common.errors import GatewayError
from biosensor_gateway.system.clock import LSL_CLOCK, Clock
from biosensor_gateway.transports.link import ByteLink, Received, ReceivedText, TextLink
from biosensor_gateway.transports.nearby import Advertisement
from biosensor_gateway.transports.ports import SYSTEM_PORTS, Ports


class What(StrEnum):
    """Kind of an event on a link."""

    OPENED = "opened"
    READ = "read"
    WRITTEN = "written"
    SUBSCRIBED = "subscribed"
    UNSUBSCRIBED = "unsubscribed"
    PAIRED = "paired"
    SENT = "sent"
    CAME = "came"
    LOST = "lost"
    CLOSED = "closed"


ASKED = frozenset({What.READ, What.WRITTEN, What.SUBSCRIBED, What.UNSUBSCRIBED, What.PAIRED})
"""What a driver asks for, and waits until it is done."""

CANCELLED = "cancelled"
"""Stands for an error: the driver did not wait for the answer."""


class Characteristic(Protocol):
    """One row of a device's GATT table, with bleak's names."""

    @property
    def uuid(self) -> str:
        """UUID of the characteristic."""
        ...

    @property
    def service_uuid(self) -> str:
        """UUID of its service."""
        ...

    @property
    def properties(self) -> Sequence[str]:
        """Its properties: ``read``, ``notify`` ..."""
        ...


@dataclass(slots=True)
class Passed:
    """An event on a link."""

    what: What
    at: str = ""  # UUID of the characteristic; empty if the link has none.
    data: bytes = b""  # The bytes that were read, written, sent or received.
    # begun_s, ended_s: LSL times of the request and its answer; equal for data without a request.
    begun_s: float = 0.0
    ended_s: float = 0.0
    error: str = ""  # `att:14` or the reason of another error; empty on success.


class Tap:
    """Collects the events on all links of one device; see :func:`tapped`."""

    def __init__(self, clock: Clock = LSL_CLOCK) -> None:
        self._clock = clock
        # By the number of a link: when it was opened, the advertisement if it is Bluetooth LE, and
        # its characteristics.
        self.links: list[tuple[float, Advertisement | None, Sequence[Characteristic]]] = []
        self.events: list[tuple[int, Passed]] = []  # With the number of the link.
        self.failed: Counter[str] = Counter()  # How often a link could not be opened, by reason.
        self.came = 0  # Number of packets from the device.
        self._has_ended = False

    @property
    def opened_s(self) -> float | None:
        """Time at which the first link was opened [s]; None before."""
        return self.links[0][0] if self.links else None

    def end(self) -> None:
        """Ignore all later events, such as the driver's closing messages."""
        self._has_ended = True

    def opened(self, seen: Advertisement | None, table: Sequence[Characteristic]) -> int:
        """Add a new link; return its number."""
        self.links.append((self._clock(), seen, table))
        return len(self.links) - 1

    def passed(self, link: int, event: Passed) -> None:
        """Add an event on a link; an answer is filled in when it arrives."""
        if not self._has_ended:
            self.events.append((link, event))
            self.came += event.what is What.CAME


class Replacement(NamedTuple):
    """Creates replacements for links other than Bluetooth LE ones."""

    byte_link: Callable[[], ByteLink]
    ports: Callable[[], Ports]


_tap: ContextVar[Tap | None] = ContextVar("tap", default=None)
_instead: ContextVar[Replacement | None] = ContextVar("instead", default=None)


@contextmanager
def tapped(tap: Tap) -> Generator[None]:
    """Connect all links that are created in this context to a tap."""
    token = _tap.set(tap)
    try:
        yield
    finally:
        _tap.reset(token)


@contextmanager
def replaced(replacement: Replacement) -> Generator[None]:
    """Replace all links that are created in this context."""
    token = _instead.set(replacement)
    try:
        yield
    finally:
        _instead.reset(token)


def is_replaced() -> bool:
    """Whether links to devices are replaced."""
    return _instead.get() is not None


def byte_link_of(link: ByteLink) -> ByteLink:
    """Return the link for a driver: this one, its replacement, or this one with a tap."""
    replacement, tap = _instead.get(), _tap.get()
    if replacement is not None:
        return replacement.byte_link()
    return link if tap is None else TappedLink(link, tap)


def text_link_of(link: TextLink) -> TextLink:
    """Return the text link for a driver; see :func:`byte_link_of`."""
    replacement, tap = _instead.get(), _tap.get()
    if replacement is not None:
        return _TextsOfBytes(replacement.byte_link())
    return link if tap is None else TappedTexts(link, tap)


def ports_of_device() -> Ports:
    """Return the ports for a driver: the system's, or their replacement."""
    replacement = _instead.get()
    return SYSTEM_PORTS if replacement is None else replacement.ports()


class LinkTap:
    """Reports the events of one link to a tap, if there is one.

    Parameters
    ----------
    clock
        The clock of the link's arrivals.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._tap = _tap.get()
        # Whether there is a tap; check it to save the call for each packet.
        self.is_heard = self._tap is not None
        self._number: int | None = None

    def opened(self, seen: Advertisement | None, table: Sequence[Characteristic]) -> None:
        """Report that the link is open."""
        if self._tap is not None:
            self._number = self._tap.opened(seen, table)

    def failed(self, error: GatewayError) -> None:
        """Report that it could not be opened."""
        if self._tap is not None:
            self._tap.failed[reason_of(error)] += 1

    def came(self, what: What, at: str, data: bytes, arrival: float) -> None:
        """Report data that arrived without a request, or were sent without an answer."""
        self._tell(Passed(what, at, data, arrival, arrival))

    def ended(self, what: What) -> None:
        """Report the end of the link, once."""
        now = self._clock() if self._number is not None else 0.0
        self._tell(Passed(what, begun_s=now, ended_s=now))
        self._number = None

    @contextmanager
    def asking(self, what: What, at: str = "", data: bytes = b"") -> Generator[Passed]:
        """Report a request that runs in this context, with its error if there is one."""
        passed = Passed(what, at, data)
        if self._number is None:
            yield passed
            return
        passed.begun_s, passed.error = self._clock(), CANCELLED
        # Now: what comes in answer may come before the question is known to have arrived.
        self._tell(passed)
        try:
            yield passed
            passed.error = ""
        except GatewayError as error:
            passed.error = reason_of(error)
            raise
        finally:
            passed.ended_s = self._clock()

    def _tell(self, passed: Passed) -> None:
        if self._tap is not None and self._number is not None:
            self._tap.passed(self._number, passed)


_Link = TypeVar("_Link", ByteLink, TextLink)


class _Tapped(Generic[_Link]):
    def __init__(self, link: _Link, tap: Tap) -> None:
        self._link = link
        with tapped(tap):
            self._tap = LinkTap(LSL_CLOCK)

    async def open(self) -> None:
        """Open the link."""
        try:
            await self._link.open()
        except GatewayError as error:
            self._tap.failed(error)
            raise
        self._tap.opened(None, [])

    async def close(self) -> None:
        """Close the link."""
        self._tap.ended(What.CLOSED)
        await self._link.close()


class TappedLink(_Tapped[ByteLink]):
    """A byte link with a tap; see :class:`~biosensor_gateway.transports.link.ByteLink`.

    Parameters
    ----------
    link
        The link to the device.
    """

    async def read(self) -> Received:
        """Wait for the next bytes."""
        try:
            received = await self._link.read()
        except GatewayError:
            self._tap.ended(What.LOST)
            raise
        self._tap.came(What.CAME, "", received.data, received.arrival)
        return received

    def write(self, data: bytes) -> None:
        """Send without waiting."""
        self._tap.came(What.SENT, "", data, LSL_CLOCK())
        self._link.write(data)


class TappedTexts(_Tapped[TextLink]):
    """A text link with a tap; see :class:`TextLink`.

    Parameters
    ----------
    link
        The link to the device.
    """

    @property
    def dropped(self) -> int:
        """Number of messages that were discarded because the queue was full."""
        return self._link.dropped

    async def read(self) -> ReceivedText:
        """Wait for the next message."""
        try:
            received = await self._link.read()
        except GatewayError:
            self._tap.ended(What.LOST)
            raise
        self._tap.came(What.CAME, "", _encoded(received.text), received.arrival)
        return received

    async def send(self, text: str) -> None:
        """Send a message."""
        self._tap.came(What.SENT, "", _encoded(text), LSL_CLOCK())
        await self._link.send(text)


class _TextsOfBytes:
    """A text link based on a byte link of which each read is a whole message."""

    dropped = 0

    def __init__(self, link: ByteLink) -> None:
        self._link = link
        self.open = link.open
        self.close = link.close

    async def read(self) -> ReceivedText:
        data, arrival_s = await self._link.read()
        return ReceivedText(data.decode("utf-8", "surrogatepass"), arrival_s)

    async def send(self, text: str) -> None:
        self._link.write(_encoded(text))


def _encoded(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")


def reason_of(error: GatewayError) -> str:
    """Return a word for an error, without the addresses and names that its message may contain."""
    code: int | None = getattr(error, "code", None)
    return str(error.reason.value) if code is None else f"att:{code}"
