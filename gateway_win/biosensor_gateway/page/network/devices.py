"""Puts streams together that belong to one device, or to one name of another program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from biosensor_common.quantities import ChannelRole
from biosensor_gateway.devices.registry import sensor_title
from biosensor_gateway.page.network.models import SeenDeviceView, SeenState, SeenStreamView
from biosensor_gateway.page.network.stream import NetworkStream
from biosensor_gateway.page.network.words import readable
from biosensor_gateway.streaming.gateway import GATEWAY

_AGENT = "Capture agent"
_REPLAY = "↻ Replay"
# The first of these that one of its streams has is how the device does.
_ORDER = (
    SeenState.STREAMING,
    SeenState.SILENT,
    SeenState.OPENING,
    SeenState.WAITING,
    SeenState.LISTED,
    SeenState.READING,
    SeenState.GONE,
)
_CONTENT_HALF = 0.5


def group_of(stream: NetworkStream) -> tuple[str, ...]:
    """Return what streams of one device have in common; it sorts devices before programs."""
    header = stream.header
    if header is None or header.foreign:
        return ("other", _played(stream), stream.core.hostname, stream.core.name)
    identity = header.identity
    who = (identity.participant, identity.sensor, identity.unit, identity.label)
    return ("program" if identity.sensor == GATEWAY.name else "device", _played(stream), *who)


def device_view(
    streams: Sequence[NetworkStream], views: Mapping[int, SeenStreamView], lost: Mapping[str, int]
) -> SeenDeviceView:
    """Describe one device by its streams, of which there is at least one."""
    shown = sorted((views[each.number] for each in streams), key=_rank)
    first = streams[0]
    identity = first.header.identity if first.is_ours and first.header else None
    states = {each.seen for each in shown}
    seen = next(each for each in _ORDER if each in states)
    worn, battery = (
        _newest(streams, views, ChannelRole.CONTACT),
        _newest(streams, views, ChannelRole.STATE_OF_CHARGE),
    )
    counts = [each.lost for each in shown if each.lost is not None]
    return SeenDeviceView(
        name=f"d{min(each.number for each in streams)}",
        title=readable(first.core.name) if identity is None else _title(identity.sensor),
        unit="" if identity is None else readable(identity.unit),
        label="" if identity is None else readable(identity.label),
        participant="" if identity is None else readable(identity.participant),
        host=readable(first.core.hostname) or "an unknown computer",
        section=_section(first),
        replay=readable(_played(first)),
        is_ours=identity is not None,
        seen=seen,
        silent_s=min(each.silent_s for each in shown if each.seen is seen),
        worn=None if worn is None else worn > _CONTENT_HALF,
        battery_percent=battery,
        lost=sum(counts) if counts else None,
        is_lost_estimated=any(each.is_lost_estimated for each in shown),
        streams=shown,
    )


def _rank(stream: SeenStreamView) -> tuple[object, ...]:
    """Order: what was measured on the body, the fastest first; then the rest, text last."""
    return (stream.is_text, not stream.is_signal, -stream.nominal_hz, stream.data_name)


def _played(stream: NetworkStream) -> str:
    """Return what it is a replay of; empty if it is measured now."""
    replay = stream.header.replay if stream.header else None
    return replay.title if replay else ""


def _section(stream: NetworkStream) -> str:
    if _played(stream):
        return f"{_REPLAY}: {_section_of_live(stream)}"
    return _section_of_live(stream)


def _section_of_live(stream: NetworkStream) -> str:
    if not stream.is_ours or stream.header is None:
        return f"Other programs on {readable(stream.core.hostname) or 'an unknown computer'}"
    identity = stream.header.identity
    if identity.sensor == GATEWAY.name:
        return "Capture agents"
    return readable(identity.participant) or "No participant set"


def _title(sensor: str) -> str:
    return _AGENT if sensor == GATEWAY.name else readable(sensor_title(sensor))


def _newest(
    streams: Sequence[NetworkStream], views: Mapping[int, SeenStreamView], role: ChannelRole
) -> float | None:
    """Return the newest value of the channel with that role, unless it is stale or unknown."""
    for stream in streams:
        roles = stream.header.roles if stream.header else ()
        values = stream.received.values
        if role in roles and len(values) == len(roles) and views[stream.number].is_fresh:
            value = float(values[roles.index(role)])
            if np.isfinite(value):
                return value
    return None
