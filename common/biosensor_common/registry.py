"""Sensor names and their declarations, each imported when it is first asked for.

A package adds a sensor with an entry point in the group
``biosensor_gateway.sensors``: its name is the sensor's name, its value loads to
a :class:`~biosensor_common.spec.SensorSpec` of that name. A built-in sensor
cannot be replaced; an entry point of its name is ignored.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import EntryPoint, entry_points

from biosensor_common.errors import SpecError, SpecReason
from biosensor_common.spec import SensorSpec

ENTRY_POINT_GROUP = "biosensor_gateway.sensors"

_BUILT_IN = {
    name: f"biosensor_common.sensors.{name}"
    for name in (
        "empatica_e4",
        "emotiv_insight",
        "shimmer3_gsr",
        "polar_h10",
        "vernier_respiration_belt",
        "zephyr",
        "ble_heart_rate",
        "gateway",
    )
}


def sensor_names() -> tuple[str, ...]:
    """Names of all known sensors: the built-in ones, then those of other packages.

    Nothing is imported for it, so a listed sensor of another package may still
    turn out to be broken.
    """
    added = {entry.name for entry in entry_points(group=ENTRY_POINT_GROUP)}
    return (*_BUILT_IN, *sorted(added - _BUILT_IN.keys()))


def sensor(name: str) -> SensorSpec:
    """Return the declaration of one sensor.

    Raises
    ------
    SpecError
        ``UNKNOWN_SENSOR``, with the known names; ``INVALID``, with the
        distribution, if another package's sensor cannot be loaded, is not a
        sensor of that name, or is offered by several packages.
    """
    if name in _BUILT_IN:
        return import_module(_BUILT_IN[name]).SENSOR
    offers = list(entry_points(group=ENTRY_POINT_GROUP, name=name))
    if not offers:
        known = ", ".join(sensor_names())
        raise SpecError(
            SpecReason.UNKNOWN_SENSOR, f"There is no sensor {name!r}; the known ones are {known}."
        )
    if len(offers) > 1:
        owners = ", ".join(sorted(_distribution(offer) for offer in offers))
        raise SpecError(
            SpecReason.INVALID, f"Sensor {name!r} is offered more than once: by {owners}."
        )
    return _load(offers[0])


def _load(offer: EntryPoint) -> SensorSpec:
    where = f"Sensor {offer.name!r} of the package {_distribution(offer)}"
    try:
        spec = offer.load()
    except Exception as error:
        raise SpecError(SpecReason.INVALID, f"{where} cannot be loaded: {error!r}.") from error
    if not isinstance(spec, SensorSpec):
        raise SpecError(SpecReason.INVALID, f"{where} is not a SensorSpec: {offer.value}.")
    if spec.name != offer.name:
        raise SpecError(SpecReason.INVALID, f"{where} declares another name: {spec.name!r}.")
    return spec


def _distribution(offer: EntryPoint) -> str:
    return offer.dist.name if offer.dist is not None else "of unknown origin"
