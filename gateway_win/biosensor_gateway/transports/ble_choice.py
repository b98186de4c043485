"""Chooses the device in range that a driver connects to."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Callable

import structlog

from biosensor_common.errors import ProtocolError, ProtocolReason, TransportError, TransportReason
from biosensor_gateway.transports import bluez
from biosensor_gateway.transports.ble_scanner import Sighting, sightings
from biosensor_gateway.transports.nearby import Advertisement

SCAN_S = 10.0
RIVALS_S = 3.0
"""Devices advertise at least once a second, but radios do not hear every one."""

_log = structlog.get_logger("biosensor_gateway.transports.ble")
_SEPARATORS = re.compile(r"[\W_]+")


class Choice:
    """One device of a kind; shared by all connections of a driver.

    Without an id, the only device in range is taken. From then on it is the
    chosen one: a second device of the kind that is switched on later must never
    take its place.

    Parameters
    ----------
    identify
        Returns the id of an advertised device of the kind (as printed on it), empty
        if it has none, and None for any other device.
    kind
        Name for messages, such as "Polar H10".
    device
        Id, name or address of the one that is wanted; case and separators do not
        matter. Empty takes the only one in range.
    advice
        What to do when it cannot be found, for the end of a sentence.
    """

    def __init__(
        self,
        identify: Callable[[Advertisement], str | None],
        kind: str,
        device: str = "",
        advice: str = "switch it on and bring it nearer",
    ) -> None:
        self._identify = identify
        self._kind = kind
        self._device = device
        self._advice = advice
        self._has_let_go = False

    @property
    def what(self) -> str:
        """The device's name for messages."""
        return f"{self._kind} {self._device}".strip()

    def keep(self, seen: Advertisement) -> None:
        """Keep to this device from now on."""
        self._device = self._device or self._identify(seen) or seen.address

    async def find(self) -> Sighting:
        """Scan until the device is heard.

        Raises
        ------
        TransportError
            ``ABSENT`` after 10 s; ``UNAVAILABLE`` or ``DENIED`` without a radio.
        ProtocolError
            ``REFUSED``: several are in range and none is chosen.
        """
        await self._let_go_once()
        async with sightings() as heard:
            try:
                async with asyncio.timeout(SCAN_S):
                    first = await self._next(heard)
            except TimeoutError as error:
                message = f"{self.what} is not in range; {self._advice}"
                raise TransportError(TransportReason.ABSENT, message) from error
            return first if self._device else await self._without_rivals(first, heard)

    async def _let_go_once(self) -> None:
        """Free the chosen device of a connection that an agent which was killed has left.

        BlueZ keeps it, and a device that is connected does not advertise. Later on the
        connection is one of this agent, and a device that was not named may be somebody's.
        """
        if self._has_let_go or not self._device:
            return
        self._has_let_go = True
        for known in await bluez.known_devices():
            if known.is_connected and self._wants(known.advertisement):
                _log.warning(
                    f"{self.what} is still connected to this computer, perhaps by an agent that "
                    "was killed; it is disconnected first"
                )
                await bluez.disconnect(known.path)

    async def _without_rivals(self, first: Sighting, heard: AsyncIterator[Sighting]) -> Sighting:
        found = {first.advertisement.address: first}
        try:
            async with asyncio.timeout(RIVALS_S):
                while True:
                    sighting = await self._next(heard)
                    found[sighting.advertisement.address] = sighting
        except TimeoutError:
            pass
        if len(found) > 1:
            names = ", ".join(sorted(self._id(each.advertisement) for each in found.values()))
            message = f"more than one {self._kind} is in range ({names})"
            raise ProtocolError(ProtocolReason.REFUSED, f"{message}; set `device` to one of them")
        return found[first.advertisement.address]

    async def _next(self, heard: AsyncIterator[Sighting]) -> Sighting:
        while True:
            sighting = await anext(heard)
            if self._wants(sighting.advertisement):
                return sighting

    def _wants(self, seen: Advertisement) -> bool:
        identity = self._identify(seen)
        if identity is None:
            return False
        wanted = _bare(self._device)
        return not wanted or wanted in {_bare(identity), _bare(seen.name), _bare(seen.address)}

    def _id(self, seen: Advertisement) -> str:
        return self._identify(seen) or seen.address


def _bare(name: str) -> str:
    return _SEPARATORS.sub("", name.casefold())
