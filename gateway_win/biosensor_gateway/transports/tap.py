"""Tells whoever wants to know what passes over the links of a device, or gives links instead.

Drivers know nothing of it, but one whose device connects to ports of this computer. Links ask when
they are made whether somebody listens; who does has said so, with :func:`tapped` or
:func:`replaced`, in the context in which the driver runs.
"""

from __future__ import annotations

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
    """What can happen on a link."""

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
    """One row of a device's GATT table, as bleak has them."""

    @property
    def uuid(self) -> str:
        """Its own UUID."""
        ...

    @property
    def service_uuid(self) -> str:
        """That of its service."""
        ...

    @property
    def properties(self) -> Sequence[str]:
        """What it can: ``read``, ``notify`` ..."""
        ...


@dataclass(slots=True)
class Passed:
    """Something that passed over a link.

    Attributes
    ----------
    what
    at
        UUID of the characteristic; empty where there are none.
    data
        What was read, written, sent or came.
    begun_s, ended_s
        LSL clock; two times where something was asked for, else when it arrived.
    error
        ``att:14`` or the reason of another error; empty if all went well.
    """

    what: What
    at: str = ""
    data: bytes = b""
    begun_s: float = 0.0
    ended_s: float = 0.0
    error: str = ""


class Tap(Protocol):
    """Is told of all links of one device."""

    def opened(self, seen: Advertisement | None, table: Sequence[Characteristic]) -> int:
        """Take a new link, with what a Bluetooth LE device said of itself; return its number."""
        ...

    def failed_to_open(self, reason: str) -> None:
        """Take an attempt to open a link that did not succeed."""
        ...

    def passed(self, link: int, what: Passed) -> None:
        """Take what passes over a link; an answer is filled in when it has come."""
        ...


class Replacement(NamedTuple):
    """Makes what takes the place of links other than those of Bluetooth LE."""

    byte_link: Callable[[], ByteLink]
    ports: Callable[[], Ports]


_tap: ContextVar[Tap | None] = ContextVar("tap", default=None)
_instead: ContextVar[Replacement | None] = ContextVar("instead", default=None)


@contextmanager
def tapped(tap: Tap) -> Generator[None]:
    """Have all links that are made meanwhile tell a tap."""
    token = _tap.set(tap)
    try:
        yield
    finally:
        _tap.reset(token)


@contextmanager
def replaced(replacement: Replacement) -> Generator[None]:
    """Create other links instead of those to devices meanwhile."""
    token = _instead.set(replacement)
    try:
        yield
    finally:
        _instead.reset(token)


def is_replaced() -> bool:
    """Whether other links stand in for those to devices."""
    return _instead.get() is not None


def byte_link_of(link: ByteLink) -> ByteLink:
    """Return the link that a driver gets: this one, the one that replaces it, or one with a tap."""
    replacement, tap = _instead.get(), _tap.get()
    if replacement is not None:
        return replacement.byte_link()
    return link if tap is None else TappedLink(link, tap)


def text_link_of(link: TextLink) -> TextLink:
    """Return the link of texts that a driver gets; see :func:`byte_link_of`."""
    replacement, tap = _instead.get(), _tap.get()
    if replacement is not None:
        return _TextsOfBytes(replacement.byte_link())
    return link if tap is None else TappedTexts(link, tap)


def ports_of_device() -> Ports:
    """Return the ports by which a driver reaches a device: the system's, or what replaces them."""
    replacement = _instead.get()
    return SYSTEM_PORTS if replacement is None else replacement.ports()


class LinkTap:
    """What one link tells, if anybody listens.

    Parameters
    ----------
    clock
        Of the link's arrivals.

    Attributes
    ----------
    is_heard
        Whether anybody listens; who asks spares each packet the telling.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._tap = _tap.get()
        self.is_heard = self._tap is not None
        self._number: int | None = None

    def opened(self, seen: Advertisement | None, table: Sequence[Characteristic]) -> None:
        """Tell that the link stands."""
        if self._tap is not None:
            self._number = self._tap.opened(seen, table)

    def failed(self, error: GatewayError) -> None:
        """Tell that it could not be opened."""
        if self._tap is not None:
            self._tap.failed_to_open(reason_of(error))

    def came(self, what: What, at: str, data: bytes, arrival: float) -> None:
        """Tell what came by itself, or was sent without waiting."""
        self._tell(Passed(what, at, data, arrival, arrival))

    def ended(self, what: What) -> None:
        """Tell that the link has ended, once."""
        now = self._clock() if self._number is not None else 0.0
        self._tell(Passed(what, begun_s=now, ended_s=now))
        self._number = None

    @contextmanager
    def asking(self, what: What, at: str = "", data: bytes = b"") -> Generator[Passed]:
        """Tell what is asked for meanwhile, and with which error if there is one."""
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
    """A byte link that tells what passes; see :class:`~biosensor_gateway.transports.link.ByteLink`.

    Parameters
    ----------
    link
        The one that carries it.
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
    """A link of texts that tells what passes; see :class:`TextLink`.

    Parameters
    ----------
    link
        The one that carries them.
    """

    @property
    def dropped(self) -> int:
        """Messages that came and could not be kept."""
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
    """A link of texts, on one of bytes of which each read is a whole message."""

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
    """Return a word for an error, without what a sentence may name: addresses, names."""
    code: int | None = getattr(error, "code", None)
    return str(error.reason.value) if code is None else f"att:{code}"
