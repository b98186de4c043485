"""Drivers, one folder a sensor; this table says which, and imports them when they are used."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from importlib import import_module
from importlib.metadata import entry_points
from typing import NamedTuple, cast

from biosensor_common.errors import ConfigError, ConfigReason
from biosensor_gateway.devices.discovery import Found
from biosensor_gateway.devices.driver import Driver
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.settings.secrets import SecretName
from biosensor_gateway.streaming.sink import DeviceSink
from biosensor_gateway.transports.nearby import Advertisement, SerialPort

ENTRY_POINT_GROUP = "biosensor_gateway.drivers"

_SENSORS = (
    "empatica_e4",
    "emotiv_insight",
    "shimmer3_gsr",
    "polar_h10",
    "vernier_respiration_belt",
    "zephyr",
    "ble_heart_rate",
)
_MODULES = {name: f"biosensor_gateway.devices.{name}.driver.driver" for name in _SENSORS}


class DriverEntry(NamedTuple):
    """What a driver module offers as its ``DRIVER``.

    Attributes
    ----------
    settings
        Model of the device's table in the settings file.
    make
        Called once a device; returns what makes a driver for each connection.
    recognise
        Tells whether an advertisement or a serial port is such a device; None for
        sensors that have neither.
    find
        Asks the vendor's services for their devices, given the settings of all configured
        devices of the sensor, which say where services are; None where there is no service.
        Raises a GatewayError if the service does not answer.
    secrets
        What the vendor's service asks for.
    unlicensed
        Asks the vendor's service what the user's licence does not cover, a clause each; None
        where nothing needs a licence. Raises a GatewayError if there is no answer.
    """

    settings: type[DeviceSettings]
    make: Callable[[DeviceSettings, DeviceSink], Callable[[], Driver]]
    recognise: Callable[[Advertisement | SerialPort], Found | None] | None = None
    find: Callable[[Sequence[DeviceSettings]], Awaitable[Sequence[Found]]] | None = None
    secrets: tuple[SecretName, ...] = ()
    unlicensed: Callable[[DeviceSettings], Awaitable[Sequence[str]]] | None = None


def driver_names() -> tuple[str, ...]:
    """Sensors that have a driver: ours, then those of other installed packages."""
    others = {entry.name for entry in entry_points(group=ENTRY_POINT_GROUP)}
    return (*_MODULES, *sorted(others - _MODULES.keys()))


def driver(name: str) -> DriverEntry:
    """Import the driver of a sensor.

    Raises
    ------
    ConfigError
        ``WRONG_VALUE``, if there is none.
    """
    if name in _MODULES:
        return cast("DriverEntry", import_module(_MODULES[name]).DRIVER)
    for entry in entry_points(group=ENTRY_POINT_GROUP, name=name):
        return cast("DriverEntry", entry.load())
    message = f"there is no driver for {name!r}; there are {', '.join(driver_names())}"
    raise ConfigError(ConfigReason.WRONG_VALUE, message)


def settings_models() -> dict[str, type[DeviceSettings]]:
    """Models of the settings file's device tables by sensor."""
    return {name: driver(name).settings for name in driver_names()}
