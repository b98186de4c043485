"""States and names of the agent's devices: those that do not stream, and the one that was meant."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from enum import Enum, unique
from typing import Any, NamedTuple

from biosensor_common.errors import ConfigError, ConfigReason, did_you_mean
from biosensor_common.spec import DeviceIdentity


@unique
class State(Enum):
    """How far a device has come towards streaming."""

    DISCOVERING = "discovering"
    CONNECTING = "connecting"
    STREAMING = "streaming"
    ENABLING = "enabling"
    """Connected; silent streams were enabled again, and their samples have not arrived yet."""
    BACKOFF = "backoff"
    STOPPED = "stopped"


CONNECTED = frozenset({State.STREAMING.value, State.ENABLING.value})
"""``ENABLING`` is included because the other streams deliver meanwhile."""
STATE_WORDS = {
    State.DISCOVERING.value: "looking for it",
    State.CONNECTING.value: "connecting",
    State.STREAMING.value: "streaming",
    State.ENABLING.value: "no data yet",
    State.BACKOFF.value: "will try again",
    State.STOPPED.value: "stopped",
}
"""The states for people; files and streams have the enum's values."""


def is_sending(state: str, *, paused: bool) -> bool:
    """Whether a device is sending, so that its last values can be current."""
    return state in CONNECTED and not paused


_HOW = {
    State.DISCOVERING.value: "is not found",
    State.CONNECTING.value: "is not connected",
    State.STREAMING.value: "streams",
    State.ENABLING.value: "does not send all of its streams",
    State.BACKOFF.value: "is not connected",
    State.STOPPED.value: "is not connected",
}


class Absence(NamedTuple):
    """A device that does not send all of its streams."""

    device: DeviceIdentity
    name: str  # Its name for people, with its participant.
    is_paused: bool
    is_partial: bool  # Whether it streams, but something is wrong with some of its streams.
    since: float | None  # Unix time in s; None if the agent does not report it.
    sentence: str  # Name, state, time and error, without a full stop.
    # source_ids of its streams that the agent has opened; empty while it sends some.
    sources: frozenset[str]


def absences(devices: Sequence[Mapping[str, Any]]) -> tuple[Absence, ...]:
    """Return the devices that are paused, not connected, or do not send all of their streams.

    Parameters
    ----------
    devices
        Devices of the agent's status.
    """
    named = zip(devices, names(devices, "'s "), strict=True)
    return tuple(_absence(each, name) for each, name in named if _is_absent(each))


def names(devices: Iterable[Mapping[str, Any]], joint: str = " ") -> list[str]:
    """Return the devices' names for people, with the unit only where two would be the same.

    Parameters
    ----------
    devices
        Devices of the agent's status.
    joint
        Text between participant and sensor.
    """
    known = list(devices)
    short = [_name(each, joint) for each in known]
    counts = Counter(short)
    return [
        f"{name} {each['unit']}" if counts[name] > 1 else name
        for name, each in zip(short, known, strict=True)
    ]


def _name(device: Mapping[str, Any], joint: str) -> str:
    # The registry brings all declarations, which `stop` and the like do without.
    from biosensor_gateway.devices.registry import sensor_title  # noqa: PLC0415 - see above

    sensor = " ".join(filter(None, (sensor_title(device["sensor"]), device["label"])))
    return joint.join(filter(None, (device["participant"], sensor)))


def identity_of(device: Mapping[str, Any]) -> DeviceIdentity:
    """Return the identity of a device of the agent's status."""
    return DeviceIdentity(device["sensor"], device["unit"], device["participant"], device["label"])


def _is_absent(device: Mapping[str, Any]) -> bool:
    is_whole = device["state"] == State.STREAMING.value and not device.get("error")
    return bool(device.get("paused")) or not is_whole


def _absence(device: Mapping[str, Any], name: str) -> Absence:
    paused, state = bool(device.get("paused")), str(device["state"])
    since: float | None = device.get("since")
    how = "is paused" if paused else _HOW.get(state, state)
    if since is not None:
        how += f" since {clock_time(since)}"
    if device.get("error") and not paused:
        how += f"{', but' if since is None else ''}: {device['error']}"
    return Absence(
        identity_of(device),
        name,
        paused,
        state == State.STREAMING.value and not paused,
        since,
        f"{name} {how}",
        frozenset(() if is_sending(state, paused=paused) else device.get("streams", ())),
    )


def clock_time(unix_s: float, *, seconds: bool = False) -> str:
    """Return a time today as ``14:03``, and a time on another day with its date."""
    then, now = datetime.fromtimestamp(unix_s).astimezone(), datetime.now().astimezone()
    day = "" if then.date() == now.date() else "%Y-%m-%d "
    return then.strftime(f"{day}%H:%M:%S" if seconds else f"{day}%H:%M")


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
