"""Plays a capture of a device that is discovered by UDP and then connects to this computer."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from biosensor_gateway.captures.file import Event
from biosensor_gateway.captures.player import LinkPlayer, Player
from biosensor_gateway.system.clock import Clock
from biosensor_gateway.transports.link import Address
from biosensor_gateway.transports.ports import ASKING, CONTROL, DATA
from biosensor_gateway.transports.tap import What
from biosensor_gateway.transports.udp_port import Take

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


class _Asking:
    def __init__(self, link: LinkPlayer) -> None:
        self._link = link

    def sendto(self, data: bytes, addr: Address) -> None:
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
