"""Base of virtual devices that are a strap with something besides."""

from __future__ import annotations

from biosensor_gateway.devices.ble_heart_rate.simulator.strap import Strap
from biosensor_gateway.simulation.virtual_device import VirtualDevice


class StrapDevice(VirtualDevice):
    """A virtual device that is on while its strap is; a subclass makes the strap."""

    _strap: Strap

    async def _start(self) -> None:
        await self._strap.start()

    async def _stop(self) -> None:
        await self._strap.stop()
