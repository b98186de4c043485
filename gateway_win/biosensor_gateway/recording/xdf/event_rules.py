"""Judges a recording by what the capture agent said in it of its devices."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.state import STATE_WORDS, State
from biosensor_gateway.recording.xdf.findings import Finding, Level
from biosensor_gateway.recording.xdf.recording import Recording
from biosensor_gateway.recording.xdf.report import Extent, Measured
from biosensor_gateway.streaming.events import EventKind

_CONNECTED = frozenset({State.STREAMING.value, State.ENABLING.value})


def tells_devices(recording: Recording) -> bool:
    """Whether an agent says in a recording which devices it had."""
    events = (each.texts for each in recording.streams if each.header.is_events)
    return any(_states(each) for each in events)


def judge_devices(streams: Sequence[Measured], extent: Extent) -> Iterator[Finding]:
    """Say what was not recorded, or not to the end, of the devices that an agent had."""
    for events in streams:
        if not events.stream.header.is_events:
            continue
        own = [each for each in streams if _is_beside(each, events)]
        yield from _left_out(own, events)
        yield from _removed(own, events, extent)


def _is_beside(stream: Measured, events: Measured) -> bool:
    header = stream.stream.header
    return header.is_of_agent and header.hostname == events.stream.header.hostname


def _left_out(own: Sequence[Measured], events: Measured) -> Iterator[Finding]:
    headers = [each.stream.header for each in own]
    recorded = {f"{each.sensor}/{each.unit}" for h in headers if (each := h.identity)}
    is_counted = any(each.is_counters for each in headers)
    for device, states in _states(events.stream.texts).items():
        if device in recorded:
            continue
        if not _CONNECTED & states.keys():
            how = ", ".join(STATE_WORDS.get(each, each) for each in states)
            text = f"{device} was never there ({how}), so nothing of it was recorded"
            yield Finding(Level.WARNING, "absent", "", text)
        elif not is_counted:
            # Else each of its streams is named that was left out.
            text = f"the agent also had {device}, of which nothing was recorded"
            yield Finding(Level.ERROR, "left-out", "", text)


def _removed(own: Sequence[Measured], events: Measured, extent: Extent) -> Iterator[Finding]:
    recorded = {each.stream.header.identity for each in own}
    ended: dict[DeviceIdentity, float] = {}
    for event in _events(events.stream.texts):
        identity = _identity(event)
        if event.get("event") == EventKind.DEVICE_REMOVED and identity in recorded:
            ended[identity] = _time(event)
        elif event.get("event") == EventKind.DEVICE_ADDED:
            # Under the same name the recorder finds its streams again.
            ended.pop(identity, None)
    for identity, at in ended.items():
        who = f" of {identity.participant}" if identity.participant else ""
        text = (
            f"{identity.sensor}/{identity.unit}{who} was removed or renamed in the settings at "
            f"{extent.since_begin(at, events):.1f} s, and nothing of it was recorded since"
        )
        yield Finding(Level.ERROR, "removed", "", text)


def _states(texts: Sequence[str]) -> Mapping[str, dict[str, None]]:
    """Return the states of each device, by ``sensor/unit``, in the order of heartbeats."""
    found: dict[str, dict[str, None]] = {}
    for event in _events(texts):
        devices: object = event.get("devices")
        if event.get("event") == EventKind.HEARTBEAT and isinstance(devices, dict):
            for device, state in cast("dict[str, object]", devices).items():
                found.setdefault(device, {})[str(state)] = None
    return found


def _events(texts: Sequence[str]) -> Iterator[Mapping[str, Any]]:
    for text in texts:
        try:
            event: object = json.loads(text)
        except (ValueError, RecursionError):
            continue
        if isinstance(event, dict):
            yield cast("dict[str, Any]", event)


def _identity(event: Mapping[str, Any]) -> DeviceIdentity:
    names = (str(event.get(key, "")) for key in ("sensor", "unit", "participant", "label"))
    return DeviceIdentity(*names)


def _time(event: Mapping[str, Any]) -> float:
    time = event.get("lsl_time")
    return float(time) if isinstance(time, int | float) else 0.0
