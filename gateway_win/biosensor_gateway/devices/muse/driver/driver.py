"""The conversation with a Muse headband."""

from __future__ import annotations

import re
from collections.abc import Callable

from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.devices.driver import Connected, DriverEntry, own_settings
from biosensor_gateway.devices.muse.driver.emitter import MuseEmitter
from biosensor_gateway.devices.muse.driver.gatt import SERVICE
from biosensor_gateway.devices.muse.driver.session import MuseSession
from biosensor_gateway.devices.muse.driver.settings import MuseSettings
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_choice import Choice
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

KIND = "Muse"
ADVICE = "switch it on (its lights run), and end its connection to phones and other programs"
_NAME = re.compile(r"Muse(?:S|Athena| Athena)?-(?P<number>\w+)")

_SEPARATORS = re.compile(r"[^0-9A-Fa-f]")


class MuseDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`."""

    # Silent streams are noticed long before.
    silence_limit_s = 30.0

    def __init__(self, session: MuseSession) -> None:
        self._session = session

    async def connect(self) -> Connected:
        """Connect and start what is wanted; see the protocol class."""
        opened = await self._session.open()
        return Connected(
            opened.info, silent=opened.silent, refused=opened.refused, denied=opened.denied
        )

    async def stream(self) -> None:
        """Emit what came while connecting, then all that comes; see the protocol class."""
        await self._session.stream()

    async def close(self) -> None:
        """Stop the headband, without waiting for its answer, and disconnect."""
        await self._session.close()

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Start everything again, as one preset has all of it; see the protocol class."""
        del streams
        await self._session.start_again()


def _make(settings: DeviceSettings, sink: Sink) -> Callable[[], MuseDriver]:
    """Share emitter and choice of the device between all connections."""
    own = own_settings(MuseSettings, settings)
    emitter = MuseEmitter(sink)
    choice = Choice(identify, KIND, own.device, ADVICE)

    def make() -> MuseDriver:
        return MuseDriver(MuseSession(BleLink(choice, sink.clock), emitter, sink, own))

    return make


def identify(seen: Advertisement) -> str | None:
    """Return the digits of a name like ``Muse-3A1F`` or ``MuseS-3A1F``; None for other devices.

    Some headbands advertise no name: their service tells them, and nothing their digits.
    """
    if not seen.name.strip():
        return "" if SERVICE in seen.service_uuids else None
    found = _NAME.fullmatch(seen.name.strip())
    return found["number"] if found else None


def recognise(seen: Advertisement | SerialPort) -> Found | None:
    """Tell whether this is a Muse."""
    if not isinstance(seen, Advertisement):
        return None
    number = identify(seen)
    if number is None:
        return None
    unit = number or _SEPARATORS.sub("", seen.address)[-4:]
    settings = {"unit": unit, "device": seen.address}
    return Found("muse", seen.name or f"{KIND} without a name", settings, seen.rssi_dbm)


# Of the headband's status: number of its chip, serial number, address, name.
IDENTIFIERS = (re.compile(rb'"(?:id|sn|ma|hn)"\s*:\s*"([^"]{4,64})"'),)
DRIVER = DriverEntry(MuseSettings, _make, recognise=recognise, identifiers=IDENTIFIERS)
