"""The EmotiBits in the network."""

from __future__ import annotations

from collections.abc import Sequence

from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.devices.emotibit.driver.advertising import (
    ADVERTISING_PORT,
    Advertising,
    Nearby,
)
from biosensor_gateway.settings.models import DeviceSettings

_LISTEN_S = 1.5


async def find(configured: Sequence[DeviceSettings]) -> list[Found]:
    """Ask where the settings say, or in the whole network, which EmotiBits there are.

    Raises
    ------
    TransportError
        This computer has no network.
    """
    places = {_place(each) for each in configured} or {("", ADVERTISING_PORT)}
    return [
        _found(nearby, host, port)
        for host, port in sorted(places)
        for nearby in await _nearby(host, port)
    ]


def _place(settings: DeviceSettings) -> tuple[str, int]:
    values = settings.model_dump()
    return values["host"], values["port"]


async def _nearby(host: str, port: int) -> list[Nearby]:
    advertising = Advertising(host, port)
    try:
        await advertising.open()
        return await advertising.nearby(_LISTEN_S, first=False)
    finally:
        advertising.close()


def _found(nearby: Nearby, host: str, port: int) -> Found:
    unit = nearby.device or nearby.address[0]
    settings: dict[str, str | int | float | bool] = {"unit": unit, "device": nearby.device}
    if host or not nearby.device:
        settings["host"] = nearby.address[0]
    if port != ADVERTISING_PORT:
        settings["port"] = port
    return Found("emotibit", f"EmotiBit {unit}", settings)
