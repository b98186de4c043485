"""Finds all sensors by name: in the folders next to this file and in other packages.

A package adds a sensor with one entry point in the group ``biosensor_gateway.sensors``: its
name is the sensor's name, its value loads to a :class:`~biosensor_gateway.devices.sensor.Sensor`.
A built-in sensor cannot be replaced; an entry point of its name is ignored.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pkgutil import iter_modules, resolve_name

from biosensor_common.errors import SpecError, SpecReason, did_you_mean
from biosensor_common.liblsl import what_is_missing
from biosensor_common.spec import SensorSpec
from biosensor_gateway.devices.driver import DriverEntry
from biosensor_gateway.devices.sensor import Sensor
from biosensor_gateway.settings.models import DeviceSettings
from biosensor_gateway.streaming.counters import GATEWAY

ENTRY_POINT_GROUP = "biosensor_gateway.sensors"

_PACKAGE = __name__.rpartition(".")[0]


@cache
def _built_in() -> Mapping[str, Sensor]:
    """Import the folders next to this file; generic sensors come last."""
    folders = iter_modules(import_module(_PACKAGE).__path__)
    found: list[Sensor] = [
        import_module(f"{_PACKAGE}.{folder.name}").SENSOR for folder in folders if folder.ispkg
    ]
    found.sort(key=lambda each: (-each.precedence, each.spec.name))
    return {each.spec.name: each for each in found}


def sensor_names() -> tuple[str, ...]:
    """Names of all sensors: the built-in ones, then those of other packages.

    Other packages are not imported, so a listed sensor may still fail to load.
    """
    added = {entry.name for entry in entry_points(group=ENTRY_POINT_GROUP)}
    return (*_built_in(), *sorted(added - _built_in().keys()))


def sensor(name: str) -> Sensor:
    """Return one sensor.

    Raises
    ------
    SpecError
        ``UNKNOWN_SENSOR``, with the known names; ``INVALID``, with the package, if another
        package's sensor cannot be loaded, is not a sensor of that name, or is offered by several
        packages.
    """
    if name in _built_in():
        return _built_in()[name]
    offers = list(entry_points(group=ENTRY_POINT_GROUP, name=name))
    if not offers:
        known = sensor_names()
        raise SpecError(
            SpecReason.UNKNOWN_SENSOR,
            f"There is no sensor {name!r}{did_you_mean(name, known)}; the known ones are "
            f"{', '.join(known)}.",
        )
    if len(offers) > 1:
        owners = ", ".join(sorted(_distribution(offer) for offer in offers))
        raise SpecError(
            SpecReason.INVALID, f"Sensor {name!r} is offered more than once: by {owners}."
        )
    return _load(offers[0])


def declaration_names() -> tuple[str, ...]:
    """Names of all declarations: the sensors, and the agent's own streams."""
    return (*sensor_names(), GATEWAY.name)


def declaration(name: str) -> SensorSpec:
    """Return the declaration of a sensor, or of the agent itself (``gateway``).

    Raises
    ------
    SpecError
        As for :func:`sensor`.
    """
    return GATEWAY if name == GATEWAY.name else sensor(name).spec


def sensor_title(name: str) -> str:
    """Return a sensor's title for users; its name if it is unknown."""
    try:
        return declaration(name).title
    except SpecError:
        return name


def declared(settings: DeviceSettings) -> SensorSpec:
    """Return the declaration of a device: its sensor's, or one from the device's settings.

    Raises
    ------
    SpecError
        As for :func:`driver`.
    """
    declare = driver(settings.sensor).declare
    return declaration(settings.sensor) if declare is None else declare(settings)


def driver(name: str) -> DriverEntry:
    """Import the driver of a sensor.

    Raises
    ------
    SpecError
        As for :func:`sensor`; ``INVALID``, if the sensor's driver is not a DriverEntry.
    """
    place = sensor(name).driver
    try:
        entry: object = resolve_name(place)
    except Exception as error:  # another package's code may raise anything
        message = f"The driver of {name!r}, {place}, cannot be loaded: {error!r}."
        raise SpecError(SpecReason.INVALID, what_is_missing(error) or message) from error
    if not isinstance(entry, DriverEntry):
        message = f"The driver of {name!r}, {place}, is not a DriverEntry."
        raise SpecError(SpecReason.INVALID, message)
    return entry


class _SettingsModels(Mapping[str, type[DeviceSettings]]):
    """Imports a driver when its settings model is accessed."""

    def __init__(self) -> None:
        self._names = sensor_names()

    def __getitem__(self, name: str) -> type[DeviceSettings]:
        if name not in self._names:
            raise KeyError(name)
        return driver(name).settings

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def settings_models() -> Mapping[str, type[DeviceSettings]]:
    """Models of the settings file's device tables by sensor.

    A lookup raises the same errors as `driver`.
    """
    return _SettingsModels()


def _load(offer: EntryPoint) -> Sensor:
    where = f"Sensor {offer.name!r} of the package {_distribution(offer)}"
    try:
        found = offer.load()
    except Exception as error:  # another package's code may raise anything
        raise SpecError(SpecReason.INVALID, f"{where} cannot be loaded: {error!r}.") from error
    if not isinstance(found, Sensor):
        raise SpecError(SpecReason.INVALID, f"{where} is not a Sensor: {offer.value}.")
    if found.spec.name != offer.name:
        raise SpecError(SpecReason.INVALID, f"{where} declares another name: {found.spec.name!r}.")
    return found


def _distribution(offer: EntryPoint) -> str:
    return offer.dist.name if offer.dist is not None else "of unknown origin"
