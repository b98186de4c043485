"""A computer's Bluetooth LE adapter on the virtual air: scan, connect, GATT requests.

Host stacks are built on it: a backend of bleak, a fake BlueZ. All of it lives in the
world's loop.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, NamedTuple, Protocol, TypeVar, cast

from bumble import core, hci
from bumble.device import Connection, Device

from biosensor_common.errors import TransportError, TransportReason
from biosensor_gateway.simulation.gatt_link import GattLink
from biosensor_gateway.simulation.radio import Radio

_T = TypeVar("_T")
_CONNECT_S = 1.0
"""A device that was just heard connects within this, or it went away again."""


class Heard(NamedTuple):
    """One advertisement or scan response.

    Attributes
    ----------
    data
        Its payload, undecoded.
    is_response
        Whether it answers a scan request.
    """

    address: str
    data: bytes
    rssi_dbm: int
    is_response: bool


Listener = Callable[[Heard], None]


class _Events(Protocol):
    def remove_listener(self, event: str, f: Callable[..., object]) -> None: ...


class Central:
    """One adapter, with any number of scans and links at the same time.

    Parameters
    ----------
    radio
        The air, which also decides whether the adapter is switched on.
    device
        From ``radio.host()``.
    """

    def __init__(self, radio: Radio, device: Device) -> None:
        self.radio = radio
        self._device = device
        self._listeners: list[Listener] = []
        self._scan_lock = asyncio.Lock()
        self._connect_lock = asyncio.Lock()
        self._tasks: set[asyncio.Task[Any]] = set()
        radio.on_switched_off.append(self._listeners.clear)
        # bumble would put advertisement and scan response together; host stacks do that.
        events = cast("_Events", device.host)
        events.remove_listener("advertising_report", device.on_advertising_report)
        device.host.on("advertising_report", self._on_report)

    @classmethod
    async def on_the_air(cls, radio: Radio) -> Central:
        """Return an adapter that is powered."""
        return cls(radio, await radio.host())

    async def close(self) -> None:
        """Leave the air; links are lost, scans hear nothing more."""
        self.radio.on_switched_off.remove(self._listeners.clear)
        self._listeners.clear()
        await self.radio.release(self._device)

    def require_power(self) -> None:
        """Refuse when Bluetooth is switched off.

        Raises
        ------
        TransportError
            ``UNAVAILABLE``.
        """
        if not self.radio.available:
            raise TransportError(TransportReason.UNAVAILABLE, "Bluetooth is switched off")

    async def listen(self, listener: Listener) -> None:
        """Scan actively; the listener gets all that is heard.

        Raises
        ------
        TransportError
            ``UNAVAILABLE`` if Bluetooth is switched off.
        """
        self.require_power()
        self._listeners.append(listener)
        try:
            await self._uncancelled(self._update_scan())
        except asyncio.CancelledError:
            self._listeners.remove(listener)
            raise

    async def unlisten(self, listener: Listener) -> None:
        """End a scan; without effect where there is none."""
        if listener in self._listeners:
            self._listeners.remove(listener)
        await self._uncancelled(self._update_scan())

    async def wait_for(self, address: str) -> None:
        """Wait until a device is heard; cancel it to give up.

        Raises
        ------
        TransportError
            ``UNAVAILABLE`` if Bluetooth is switched off.
        """
        found = asyncio.Event()

        def listener(heard: Heard) -> None:
            if heard.address == address.upper():
                found.set()

        await self.listen(listener)
        self.radio.on_switched_off.append(found.set)
        try:
            await found.wait()
        finally:
            self.radio.on_switched_off.remove(found.set)
            await self.unlisten(listener)
        self.require_power()

    async def connect(self, address: str) -> GattLink:
        """Connect as soon as the device is heard, and discover its services.

        It waits for ever; cancel it to give up.

        Raises
        ------
        TransportError
            ``UNAVAILABLE`` if Bluetooth is switched off, ``LOST`` if the device went
            away while its services were discovered.
        """
        while True:
            await self.wait_for(address)
            attempt = self._spawn(self._establish(address))
            try:
                connection = await asyncio.shield(attempt)
            except asyncio.CancelledError:
                attempt.add_done_callback(self._abandon)
                raise
            if connection:
                return await GattLink.open(connection, self.radio.host_mtu)

    async def _establish(self, address: str) -> Connection | None:
        async with self._connect_lock:
            try:
                return await self._device.connect_le(hci.Address(address), timeout=_CONNECT_S)
            except (core.ConnectionError, core.TimeoutError):
                return None

    def _abandon(self, attempt: asyncio.Future[Connection | None]) -> None:
        if not attempt.cancelled() and (connection := attempt.result()):
            self._spawn(connection.disconnect())

    async def _uncancelled(self, coroutine: Coroutine[Any, Any, None]) -> None:
        # A command to the controller whose answer nobody awaits confuses bumble.
        await asyncio.shield(self._spawn(coroutine))

    def _spawn(self, coroutine: Coroutine[Any, Any, _T]) -> asyncio.Task[_T]:
        task = asyncio.ensure_future(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def _update_scan(self) -> None:
        async with self._scan_lock:
            if self._listeners and not self._device.scanning:
                await self._device.start_scanning()
            elif not self._listeners and self._device.scanning:
                await self._device.stop_scanning()

    def _on_report(self, report: hci.HCI_LE_Advertising_Report_Event.Report) -> None:
        response = report.event_type == hci.HCI_LE_Advertising_Report_Event.EventType.SCAN_RSP
        address = report.address.to_string(with_type_qualifier=False)
        heard = Heard(address, report.data, report.rssi, response)
        for listener in list(self._listeners):
            listener(heard)
