"""Searches for devices by Bluetooth LE, at serial ports and at the vendors' services."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

import structlog
from pydantic import BaseModel, Field

from biosensor_common.errors import GatewayError
from biosensor_gateway.devices.driver import DriverEntry, Found
from biosensor_gateway.devices.registry import declaration, driver, sensor, sensor_names
from biosensor_gateway.settings.editor import table_lines
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.transports.ble_scanner import scan as scan_bluetooth
from biosensor_gateway.transports.nearby import Advertisement, SerialPort
from biosensor_gateway.transports.serial_port import serial_ports

_ADDRESS = "device"
_IDENTIFIER = re.compile(r"[0-9A-F]{8}(-[0-9A-F]{4}){3}-[0-9A-F]{12}", re.IGNORECASE)
"""Identifier of a Bluetooth device on macOS."""

_log = structlog.get_logger("biosensor_gateway.scan")


class FoundDevice(BaseModel):
    """A device that a search found."""

    sensor: str
    title: str  # Name of the kind of sensor for people.
    name: str
    rssi_dbm: int | None  # Signal strength; None without a radio.
    # settings, toml: fields for its table in the settings, and the same as lines of the file.
    settings: dict[str, Any]
    toml: str
    is_known: bool  # Whether it is in the settings already.


class SearchedPlace(BaseModel):
    """One kind of place that was searched."""

    where: str
    problem: str | None = None  # Why the search was not possible, one sentence; None if it was.
    others: list[str] = Field(default_factory=list[str])  # Other devices or ports, in words.
    # How to distinguish devices with the same name.
    advice: list[str] = Field(default_factory=list[str])
    found: list[FoundDevice] = Field(default_factory=list[FoundDevice])


async def scan(seconds: float, configured: Sequence[DeviceSettings]) -> list[SearchedPlace]:
    """Search everywhere at once.

    Parameters
    ----------
    configured
        Devices of the settings, which have the addresses of services, and are known.
    """
    entries = drivers_by_precedence()
    searches: list[Awaitable[SearchedPlace]] = [
        _section("Bluetooth LE", lambda: _bluetooth(entries, seconds)),
        _section("Serial ports", lambda: _serial(entries)),
    ]
    for name, entry in entries.items():
        if entry.find is not None:
            devices = [each for each in configured if each.sensor == name]
            title = f"{declaration(name).title} by its service"
            searches.append(_section(title, _service(entry.find, devices)))
    places = await asyncio.gather(*searches)
    mark_known(places, configured)
    return list(places)


def mark_known(places: Sequence[SearchedPlace], configured: Sequence[DeviceSettings]) -> None:
    """Note which of the devices that were found are in the settings."""
    known = {(each.sensor, each.unit) for each in configured}
    for each in (found for place in places for found in place.found):
        each.is_known = (each.sensor, str(each.settings.get("unit"))) in known


def drivers_by_precedence() -> dict[str, DriverEntry]:
    """Import all drivers; the first one that recognizes a device gets it."""
    names = sorted(sensor_names(), key=lambda name: -sensor(name).precedence)
    return {name: driver(name) for name in names}


_Search = Callable[[], Awaitable[tuple[Sequence[Found], Sequence[str]]]]


async def _section(title: str, search: _Search) -> SearchedPlace:
    try:
        found, others = await search()
    except GatewayError as error:
        return SearchedPlace(where=title, problem=str(error))
    except Exception as error:  # noqa: BLE001 - whatever one search runs into, the others go on
        _log.error("a search failed", where=title, exc_info=error)
        return SearchedPlace(where=title, problem=f"the search failed ({type(error).__name__})")
    return place_of(title, found, others)


def place_of(title: str, found: Sequence[Found], others: Sequence[str]) -> SearchedPlace:
    """Return what was found at one kind of place; its devices are not marked as known."""
    return SearchedPlace(
        where=title, others=list(others), advice=_advice(found), found=[*map(_described, found)]
    )


def _service(
    find: Callable[[Sequence[DeviceSettings]], Awaitable[Sequence[Found]]],
    configured: Sequence[DeviceSettings],
) -> _Search:
    async def search() -> tuple[Sequence[Found], Sequence[str]]:
        return await find(configured), ()

    return search


async def _bluetooth(
    entries: dict[str, DriverEntry], seconds: float
) -> tuple[list[Found], list[str]]:
    found: list[Found] = []
    others: list[str] = []
    for seen in await scan_bluetooth(seconds):
        known = recognised(entries, seen)
        if known is not None:
            found.append(known)
        elif seen.name:
            others.append(f"{seen.name} ({seen.address}, {seen.rssi_dbm} dBm)")
    return found, others


async def _serial(entries: dict[str, DriverEntry]) -> tuple[list[Found], list[str]]:
    found: list[Found] = []
    others: list[str] = []
    for port in await serial_ports():
        known = recognised(entries, port)
        if known is not None:
            found.append(known)
        else:
            others.append(f"{port.port} {port.remote_name}".strip())
    return found, others


def recognised(entries: dict[str, DriverEntry], seen: Advertisement | SerialPort) -> Found | None:
    """Return the device as the first driver recognizes it; None if none does."""
    for entry in entries.values():
        found = entry.recognise(seen) if entry.recognise is not None else None
        if found is not None:
            return found
    return None


def _advice(found: Sequence[Found]) -> list[str]:
    """Return how to distinguish devices with the same name, or with only an identifier."""
    addresses: dict[str, set[str]] = {}
    for each in found:
        addresses.setdefault(each.name, set()).add(str(each.settings.get(_ADDRESS, "")))
    advice = [
        f"{len(alike)} have the name {name}: only the address under `device` distinguishes them. "
        "Hold one close to this computer and scan again: the nearest comes first."
        for name, alike in addresses.items()
        if len(alike) > 1
    ]
    if any(_IDENTIFIER.fullmatch(each) for alike in addresses.values() for each in alike):
        advice.append(
            "macOS shows identifiers instead of addresses: another computer has others for the "
            "same devices. To see which is which, hold one close to this computer and scan "
            "again: the nearest comes first."
        )
    return advice


def _described(found: Found) -> FoundDevice:
    return FoundDevice(
        sensor=found.sensor,
        title=declaration(found.sensor).title,
        name=found.name,
        rssi_dbm=found.rssi_dbm,
        settings=dict(found.settings),
        toml=table_lines(found.sensor, found.settings),
        is_known=False,
    )
