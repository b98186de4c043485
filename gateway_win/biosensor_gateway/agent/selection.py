"""Finds a device of the agent by a name that a person gave."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from biosensor_common.errors import ConfigError, ConfigReason, did_you_mean
from biosensor_common.spec import DeviceIdentity


def device_name(identity: DeviceIdentity) -> str:
    """Return the name of a device, ``sensor/unit``.

    It is unique among the devices of the settings, but not among virtual ones.
    """
    return f"{identity.sensor}/{identity.unit}"


def unique_names(devices: Sequence[DeviceIdentity]) -> list[str]:
    """Return each device's ``sensor/unit``; if several share it, the longer name of `described`."""
    counts = Counter(map(device_name, devices))
    return [
        described(each) if counts[device_name(each)] > 1 else device_name(each) for each in devices
    ]


def holders(name: str, devices: Iterable[DeviceIdentity]) -> tuple[DeviceIdentity, ...]:
    """Return the devices with a name from `unique_names`.

    There are several if the program that wrote the name did not distinguish them.
    """
    known = tuple(devices)
    exact = tuple(each for each in known if described(each) == name)
    return exact or tuple(each for each in known if device_name(each) == name)


def chosen(name: str, devices: Iterable[DeviceIdentity]) -> DeviceIdentity:
    """Return the device with this name.

    Parameters
    ----------
    name
        Its sensor, label, participant or ``sensor/unit``, or its name from `described`.

    Raises
    ------
    ConfigError
        ``NOT_FOUND`` if no device has the name, ``WRONG_VALUE`` if several have it; the message
        lists the candidates.
    """
    known = list(devices)
    matching = [each for each in known if described(each) == name]
    matching = matching or [each for each in known if device_name(each) == name]
    if not matching:
        matching = [
            each for each in known if name and name in (each.sensor, each.label, each.participant)
        ]
    if len(matching) == 1:
        return matching[0]
    if matching:
        message = f"several devices have the name {name!r}; choose one: {_listed(matching)}"
        raise ConfigError(ConfigReason.WRONG_VALUE, message)
    there = f"there are: {_listed(known)}" if known else "there is none"
    callable_by = (e for each in known for e in (device_name(each), each.sensor, each.label))
    hint = did_you_mean(name, filter(None, callable_by))
    raise ConfigError(ConfigReason.NOT_FOUND, f"no device has the name {name!r}{hint}; {there}")


def _listed(devices: Iterable[DeviceIdentity]) -> str:
    return ", ".join(described(each) for each in devices)


def described(identity: DeviceIdentity) -> str:
    """Return a device's name with its wearer, ``polar_h10/virtual (P01)``.

    It is also unique among virtual devices, of which several people may wear the same kind.
    """
    worn = " ".join(part for part in (identity.participant, identity.label) if part)
    return device_name(identity) + (f" ({worn})" if worn else "")
