"""Shares one Bluetooth LE scan per event loop among all searches for devices."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import ExitStack, asynccontextmanager, suppress
from dataclasses import replace
from typing import NamedTuple, TypeVar
from weakref import WeakKeyDictionary

from bleak import BleakScanner
from bleak.backends.device import BLEDevice
from bleak.backends.scanner import AdvertisementData

from biosensor_gateway.transports.ble_errors import late_scan, scan_error
from biosensor_gateway.transports.nearby import Advertisement
from biosensor_gateway.transports.threads import in_background, outlasting

START_LIMIT_S = 10.0
STOP_LIMIT_S = 2.0
RECENT_S = 15.0
"""Longer than BlueZ leaves a device unmentioned that keeps still and advertises."""
SILENT_S = 30.0
"""A scan that hears nothing for so long may be dead without an error: the radio was off."""
MAX_SEEN = 500

_T = TypeVar("_T")

_NO_RSSI = (127, -127)
"""The controller's and bleak's way of saying "unknown"."""


class Sighting(NamedTuple):
    """An advertisement, with bleak's handle of the device."""

    device: BLEDevice
    advertisement: Advertisement
    heard_s: float
    """On the event loop's clock."""


@asynccontextmanager
async def sightings(address: str = "") -> AsyncGenerator[AsyncIterator[Sighting]]:
    """Scan while the context is active: yield recently received devices, then each new one.

    Parameters
    ----------
    address
        Only this device, so that advertisements of many others do not wake the caller.

    Raises
    ------
    TransportError
        ``UNAVAILABLE`` or ``DENIED``: no radio, radio off, or no permission.
    """
    scan = _shared_scan()
    queue = await scan.join(address)
    try:
        yield _Heard(queue, lambda sighting: sighting)
    finally:
        await scan.leave(queue)


@asynccontextmanager
async def advertisements() -> AsyncGenerator[AsyncIterator[Advertisement]]:
    """Yield only the advertisements; see :func:`sightings`.

    Each is merged with the device's previous ones, because its name may only be in the scan
    response.
    """
    scan = _shared_scan()
    queue = await scan.join()
    try:
        yield _Heard(queue, lambda sighting: sighting.advertisement)
    finally:
        await scan.leave(queue)


async def scan(seconds: float) -> list[Advertisement]:
    """Return the advertisements of *seconds*, one per device, the strongest first."""
    newest: dict[str, Advertisement] = {}
    async with advertisements() as heard:
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                async for each in heard:
                    newest[each.address] = each
    return sorted(newest.values(), key=_strength, reverse=True)


def forget(address: str) -> None:
    """Require a new advertisement of a device, because connecting to it failed."""
    _shared_scan().forget(address)


class _Heard(AsyncIterator[_T]):
    """The devices received for one caller; unlike a generator it survives a timeout."""

    def __init__(self, queue: asyncio.Queue[Sighting], take: Callable[[Sighting], _T]) -> None:
        self._queue = queue
        self._take = take

    async def __anext__(self) -> _T:
        return self._take(await self._queue.get())


class _SharedScan:
    """A scan that runs while it has callers."""

    def __init__(self) -> None:
        self._now = asyncio.get_running_loop().time
        self._switching = asyncio.Lock()
        self._scanner: BleakScanner | None = None
        self._starting: asyncio.Task[None] | None = None
        self._stopping: asyncio.Task[None] | None = None
        # By address; under the empty one, those who listen to all devices.
        self._listeners = defaultdict[str, set[asyncio.Queue[Sighting]]](set)
        self._seen: dict[str, Sighting] = {}
        self._last_heard_s = 0.0

    async def join(self, address: str = "") -> asyncio.Queue[Sighting]:
        queue: asyncio.Queue[Sighting] = asyncio.Queue()
        async with self._switching:
            if self._scanner is not None and self._now() - self._last_heard_s > SILENT_S:
                await self._stop()
            if self._scanner is None:
                await self._start()
            self._listeners[address].add(queue)
        recently = self._now() - RECENT_S
        for sighting in self._seen.values():
            if sighting.heard_s > recently and address in {"", sighting.device.address}:
                queue.put_nowait(sighting)
        return queue

    async def leave(self, queue: asyncio.Queue[Sighting]) -> None:
        for address, queues in list(self._listeners.items()):
            queues.discard(queue)
            if not queues:
                del self._listeners[address]
        # Finished in the background if whoever leaves is cancelled.
        await asyncio.wait({in_background(self._stop_unless_used())}, timeout=STOP_LIMIT_S)

    def forget(self, address: str) -> None:
        self._seen.pop(address, None)

    async def _start(self) -> None:
        """Start, or continue to wait for an abandoned start: the system refuses two at a time."""
        await self._ended(STOP_LIMIT_S)
        starting = self._starting
        if starting is None or starting.done():
            starting = self._starting = in_background(self._begin())
        try:
            await outlasting(START_LIMIT_S, starting)
        except TimeoutError as error:
            raise late_scan(START_LIMIT_S) from error
        except Exception as error:  # turned into ours: backends raise what their system does
            raise scan_error(error) from error

    async def _begin(self) -> None:
        # Without duplicates BlueZ would not report again what it has reported once.
        scanner = BleakScanner(self._heard, bluez={"filters": {"DuplicateData": True}})
        with ExitStack() as undoing:
            undoing.callback(lambda: in_background(scanner.stop()))
            await scanner.start()
            undoing.pop_all()
        self._scanner, self._last_heard_s = scanner, self._now()
        # Whoever asked may have given up by now.
        in_background(self._stop_unless_used())

    async def _stop_unless_used(self) -> None:
        async with self._switching:
            if not self._listeners:
                await self._stop()

    async def _stop(self) -> None:
        scanner, self._scanner = self._scanner, None
        self._seen.clear()
        if scanner is not None:
            self._stopping = in_background(scanner.stop())
            await self._ended(STOP_LIMIT_S)

    async def _ended(self, limit_s: float) -> None:
        """Wait for the end of a stopped scan; if it hangs, abandon it."""
        if self._stopping is not None:
            # A radio that is gone refuses; the scan is over all the same.
            await asyncio.wait({self._stopping}, timeout=limit_s)

    def _heard(self, device: BLEDevice, data: AdvertisementData) -> None:
        self._last_heard_s = self._now()
        before = self._seen.pop(device.address, None)
        known = Advertisement(device.address) if before is None else before.advertisement
        sighting = Sighting(device, _merged(known, device, data), self._last_heard_s)
        # Least recently heard first: phones keep changing their address.
        self._seen[device.address] = sighting
        while len(self._seen) > MAX_SEEN:
            del self._seen[next(iter(self._seen))]
        for address in ("", device.address):
            for queue in self._listeners.get(address, ()):
                queue.put_nowait(sighting)


_scans: WeakKeyDictionary[asyncio.AbstractEventLoop, _SharedScan] = WeakKeyDictionary()


def _shared_scan() -> _SharedScan:
    return _scans.setdefault(asyncio.get_running_loop(), _SharedScan())


def _merged(known: Advertisement, device: BLEDevice, data: AdvertisementData) -> Advertisement:
    return replace(
        known,
        name=data.local_name or device.name or known.name,
        rssi_dbm=known.rssi_dbm if data.rssi in _NO_RSSI else data.rssi,
        service_uuids=known.service_uuids | {uuid.lower() for uuid in data.service_uuids},
        manufacturer_data={**known.manufacturer_data, **data.manufacturer_data},
    )


def _strength(seen: Advertisement) -> int:
    return -128 if seen.rssi_dbm is None else seen.rssi_dbm
