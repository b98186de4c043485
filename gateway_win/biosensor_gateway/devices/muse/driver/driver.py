"""The conversation with a Muse headband."""

from __future__ import annotations

from collections.abc import Callable

from biosensor_gateway.devices.driver import Connected, DriverEntry, own_settings
from biosensor_gateway.devices.muse.driver.discovery import ADVICE, KIND, identify, recognise
from biosensor_gateway.devices.muse.driver.emitter import MuseEmitter
from biosensor_gateway.devices.muse.driver.session import MuseSession
from biosensor_gateway.devices.muse.driver.settings import MuseSettings
from biosensor_gateway.devices.sink import Sink
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.ble import BleLink
from biosensor_gateway.transports.ble_choice import Choice


class MuseDriver:
    """One connection; see :class:`~biosensor_gateway.devices.driver.Driver`.

    Parameters
    ----------
    session
    """

    # Silent streams are noticed long before.
    silence_limit_s = 30.0

    def __init__(self, session: MuseSession) -> None:
        self._session = session

    async def connect(self) -> Connected:
        """Connect and start what is wanted; see the protocol class."""
        opened = await self._session.open()
        return Connected(opened.info, silent=opened.silent, refused=opened.refused)

    async def stream(self) -> None:
        """Emit what came while connecting, then all that comes; see the protocol class."""
        await self._session.stream()

    async def close(self) -> None:
        """Stop the headband, without waiting for its answer, and disconnect."""
        await self._session.close()

    async def enable_again(self, streams: frozenset[str]) -> None:
        """Start everything anew, as one preset has all of it; see the protocol class."""
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


DRIVER = DriverEntry(MuseSettings, _make, recognise=recognise)
