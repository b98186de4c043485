"""Says which devices of an agent do not stream, how, and since when."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any, NamedTuple

from biosensor_gateway.agent.state import State, is_sending
from biosensor_gateway.devices.registry import sensor_title

_HOW = {
    State.DISCOVERING.value: "is not found",
    State.CONNECTING.value: "is not connected",
    State.STREAMING.value: "streams",
    State.ENABLING.value: "does not send all of its streams",
    State.BACKOFF.value: "is not connected",
    State.STOPPED.value: "is not connected",
}


class Absence(NamedTuple):
    """A device that does not send all that it should.

    Attributes
    ----------
    device
        Its ``sensor/unit``.
    name
        What people call it, and whose it is.
    is_partial
        Whether it streams, and something is wrong with a part of its streams.
    since
        Unix time in s; None where the agent does not say it.
    sentence
        All of it for people, without a full stop.
    sources
        source_ids of its streams, as far as the agent has opened them; none while some come.
    """

    device: str
    name: str
    is_paused: bool
    is_partial: bool
    since: float | None
    sentence: str
    sources: frozenset[str]


def absences(devices: Sequence[Mapping[str, Any]]) -> tuple[Absence, ...]:
    """Return the devices that are paused, not connected, or do not send all of their streams.

    Parameters
    ----------
    devices
        As the agent's status has them.
    """
    named = zip(devices, names(devices, "'s "), strict=True)
    return tuple(_absence(each, name) for each, name in named if _is_absent(each))


def names(devices: Iterable[Mapping[str, Any]], joint: str = " ") -> list[str]:
    """Return what people call devices; with the unit where it takes one to tell them apart.

    Parameters
    ----------
    devices
        As the agent's status has them.
    joint
        Stands between participant and sensor.
    """
    known = list(devices)
    short = [_name(each, joint) for each in known]
    counts = Counter(short)
    return [
        f"{name} {each['unit']}" if counts[name] > 1 else name
        for name, each in zip(short, known, strict=True)
    ]


def _name(device: Mapping[str, Any], joint: str) -> str:
    sensor = " ".join(filter(None, (sensor_title(device["sensor"]), device["label"])))
    return joint.join(filter(None, (device["participant"], sensor)))


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
        f"{device['sensor']}/{device['unit']}",
        name,
        paused,
        state == State.STREAMING.value and not paused,
        since,
        f"{name} {how}",
        frozenset(() if is_sending(state, paused=paused) else device.get("streams", ())),
    )


def clock_time(unix_s: float, *, seconds: bool = False) -> str:
    """Return a time of today as ``14:03``, of another day with its date."""
    then, now = datetime.fromtimestamp(unix_s).astimezone(), datetime.now().astimezone()
    day = "" if then.date() == now.date() else "%Y-%m-%d "
    return then.strftime(f"{day}%H:%M:%S" if seconds else f"{day}%H:%M")
