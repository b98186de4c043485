"""Selects the device in range that a driver connects to, and keeps it selected."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Callable, Sequence
from weakref import WeakKeyDictionary, WeakSet

import structlog

from biosensor_common.errors import ProtocolError, ProtocolReason, TransportError, TransportReason
from biosensor_gateway.transports import bluez
from biosensor_gateway.transports.ble_scanner import Sighting, sightings
from biosensor_gateway.transports.nearby import Advertisement

SCAN_S = 10.0
OTHERS_S = 3.0
"""Devices advertise at least once a second, but radios do not hear every one."""

_log = structlog.get_logger("biosensor_gateway.transports.ble")
_SEPARATORS = re.compile(r"[\W_]+")


class Choice:
    """One device of a kind; shared by all connections of a driver.

    A device that is not identified by its id or address, but by its name or as the only one in
    range, is used if no other matches and no other choice of the event loop claims it. After a
    connection the device stays selected by its address: a second device of the same kind or name
    must never replace it.

    Parameters
    ----------
    identify
        Returns the id of an advertised device of the kind (as printed on it), empty
        if it has none, and None for any other device.
    kind
        Name for messages, such as "Polar H10".
    device
        Id, name or address of the requested device; case and separators do not
        matter. Empty selects the only one in range.
    advice
        What to do if it cannot be found, as the end of a sentence.
    is_generic
        The kind includes devices of more specific kinds, which are left to choices of those
        kinds.
    connects
        Whether to connect; a device whose advertisements are only received may be connected to
        another computer.
    """

    def __init__(
        self,
        identify: Callable[[Advertisement], str | None],
        kind: str,
        device: str = "",
        advice: str = "switch it on and bring it nearer",
        *,
        is_generic: bool = False,
        connects: bool = True,
    ) -> None:
        self._identify = identify
        self._kind = kind
        self._device = device
        self._advice = advice
        self._is_generic = is_generic
        self._may_hold, self._gave_up = connects, False
        self._kept = ""
        self._kept_seen = Advertisement("")
        self._found = ""
        self._passed_over: dict[str, Advertisement] = {}
        self._alike: dict[str, Advertisement] = {}
        self._warned_of: set[str] = set()

    @property
    def what(self) -> str:
        """Name of the device in messages."""
        return f"{self._kind} {self._device}".strip()

    def note_given_up(self) -> None:
        """Note that an attempt to connect was abandoned before its result."""
        self._may_hold = self._gave_up = True

    def keep(self, seen: Advertisement) -> None:
        """Keep this device selected from now on."""
        self._may_hold = self._gave_up = False
        if not self._kept and not self._is_certain(seen):
            say = _log.warning if self._device else _log.info
            say(
                f'{self.what}: connected to {_shown(seen)}; set device = "{seen.address}" in its '
                "table, so that the next start cannot take another one instead"
            )
        self._device = self._device or self._identify(seen) or seen.address
        self._kept, self._kept_seen = seen.address, seen

    def claims(self, seen: Advertisement, *, from_generic: bool) -> bool:
        """Whether a device belongs to this choice rather than to a less specific one.

        Parameters
        ----------
        from_generic
            The other choice is of a generic kind.
        """
        if self._found:
            return seen.address == self._found
        if self._device:
            return self._answers(seen)
        return from_generic and not self._is_generic and self._answers(seen)

    async def find(self) -> Sighting:
        """Scan until the device is found.

        Raises
        ------
        TransportError
            ``ABSENT`` after 10 s; ``UNAVAILABLE`` or ``DENIED`` without a radio.
        ProtocolError
            ``REFUSED``: several devices are in range and none is selected.
        """
        self._found = self._kept
        self._passed_over.clear()
        self._alike.clear()
        _of_this_loop().add(self)
        await self._let_go()
        async with sightings() as heard:
            try:
                async with asyncio.timeout(SCAN_S):
                    found = await self._next(heard)
            except TimeoutError as error:
                raise await self._absence() from error
            if not self._is_certain(found.advertisement):
                found = await self._without_others(found, heard)
            # Before the scan ends, which takes its time: others must not come to it meanwhile.
            self._found = found.advertisement.address
        return found

    async def _let_go(self) -> None:
        """End an unused connection to the device, before its first connection.

        A killed agent has left it, or an abandoned attempt has succeeded. BlueZ keeps it, and a
        connected device does not advertise. Later the connection may be this agent's, and a device
        that is not identified by its id or address may be in use by another program.
        """
        if not self._may_hold:
            return
        # Once, but that what was given up may come through at any time.
        self._may_hold = self._gave_up
        for known in await bluez.known_devices():
            seen = known.advertisement
            is_free = self._is_certain(seen) or not known.is_listened_to
            if known.is_connected and is_free and self._wants(seen):
                _log.warning(
                    f"{self.what} is still connected to this computer ({_shown(seen)}), perhaps "
                    "by an agent that was killed, or after an attempt that took too long; it is "
                    "disconnected first"
                )
                await bluez.disconnect(known.path)

    async def _without_others(self, first: Sighting, heard: AsyncIterator[Sighting]) -> Sighting:
        newest = {first.advertisement.address: first}
        try:
            async with asyncio.timeout(OTHERS_S):
                async for sighting in heard:
                    newest[sighting.advertisement.address] = sighting
        except TimeoutError:
            pass
        # Its name may have come later, or another choice to it.
        left = [each for each in newest.values() if self._wants(each.advertisement)]
        if len(left) > 1:
            raise self._too_many([each.advertisement for each in left])
        if not left:
            raise await self._absence()
        return left[0]

    async def _next(self, heard: AsyncIterator[Sighting]) -> Sighting:
        while True:
            sighting = await anext(heard)
            if self._wants(sighting.advertisement):
                return sighting

    def _wants(self, seen: Advertisement) -> bool:
        if self._is_certain(seen):
            return True
        if not self._answers(seen):
            if self._kept and self._is_alike(seen) and not self._is_of_another(seen):
                self._alike[seen.address] = seen
            return False
        if self._kept:
            self._warn_of(seen)
        elif not self._is_of_another(seen):
            return True
        self._passed_over[seen.address] = seen
        return False

    def _answers(self, seen: Advertisement) -> bool:
        """Whether it is of the kind, and may be the device of the settings."""
        wanted = _bare(self._device)
        if wanted and wanted == _bare(seen.address):
            # What it is, its services tell; its name may be missing.
            return True
        identity = self._identify(seen)
        if identity is None:
            return False
        return not wanted or wanted in {_bare(identity), _bare(seen.name), _bare(seen.address)}

    def _is_certain(self, seen: Advertisement) -> bool:
        """Whether it is identified with certainty: by id, by address, or as the previous device."""
        if self._kept:
            return seen.address == self._kept
        identity, wanted = self._identify(seen), _bare(self._device)
        if not wanted:
            return False
        return wanted == _bare(seen.address) or (identity is not None and wanted == _bare(identity))

    def _is_alike(self, seen: Advertisement) -> bool:
        """Whether it may be the previous device with a new address."""
        before = self._kept_seen
        if seen.name and before.name:
            return seen.name == before.name
        # A name comes later than the rest.
        return bool(seen.service_uuids & before.service_uuids)

    def _is_of_another(self, seen: Advertisement) -> bool:
        others = [each for each in _of_this_loop() if each is not self]
        return any(each.claims(seen, from_generic=self._is_generic) for each in others)

    def _warn_of(self, seen: Advertisement) -> None:
        if seen.address not in self._warned_of:
            self._warned_of.add(seen.address)
            _log.warning(
                f"another device also matches {self._device} ({_shown(seen)}); it is not used "
                f"instead of the one that was connected ({self._kept})"
            )

    def _too_many(self, seen: Sequence[Advertisement]) -> ProtocolError:
        if self._device:
            message = (
                f"more than one device in range has the name {self._device} "
                f"({_addresses(seen)}); set `device` to the address of yours: `scan` lists the "
                "nearest first"
            )
        else:
            names = ", ".join(sorted(self._identify(each) or each.address for each in seen))
            message = (
                f"more than one {self._kind} is in range ({names}); set `device` to one of them"
            )
        return ProtocolError(ProtocolReason.REFUSED, message)

    async def _absence(self) -> TransportError:
        """Return the error for a device that is not found, with the reason if known."""
        heard = list(self._passed_over.values())
        for known in await bluez.known_devices():
            if known.is_connected and self._wants(known.advertisement):
                address = known.advertisement.address
                message = (
                    f"{self.what} is already connected to this computer; end the program that "
                    f"uses it, or free it: bluetoothctl disconnect {address}"
                )
                return TransportError(TransportReason.ABSENT, message)
        message = f"{self.what} is not in range; {self._advice}"
        if heard and self._kept:
            message = (
                f"{self.what} ({self._kept}) is not in range, only another that matches "
                f"({_addresses(heard)}); {self._advice}, or set `device` to the address of yours"
            )
        elif self._alike:
            names = ", ".join(sorted(map(_shown, self._alike.values())))
            message = (
                f"{self.what} is not in range, only another like it ({names}); {self._advice}, or, "
                "if that is yours and its address has changed, set `device` to the new one"
            )
        elif heard:
            names = ", ".join(sorted(map(_shown, heard)))
            message = (
                f"{self.what} is not in range, only devices that other tables of the settings "
                f"use ({names}); {self._advice}"
            )
        return TransportError(TransportReason.ABSENT, message)


_choices: WeakKeyDictionary[asyncio.AbstractEventLoop, WeakSet[Choice]] = WeakKeyDictionary()


def _of_this_loop() -> WeakSet[Choice]:
    """Return all choices of the running event loop that were ever searched for."""
    return _choices.setdefault(asyncio.get_running_loop(), WeakSet())


def _shown(seen: Advertisement) -> str:
    return f"{seen.name} {seen.address}".strip()


def _addresses(seen: Sequence[Advertisement]) -> str:
    return ", ".join(sorted(each.address for each in seen))


def _bare(name: str) -> str:
    return _SEPARATORS.sub("", name.casefold())
