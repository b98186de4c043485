"""Puts the agent's status into what the page shows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from biosensor_common import naming
from biosensor_common.errors import SpecError
from biosensor_common.quantities import TYPES_OF_DEVICE
from biosensor_common.spec import DeviceIdentity, StreamSpec
from biosensor_gateway.agent.pauses.selection import device_name
from biosensor_gateway.agent.rate_meter import STALE_AFTER_S, RateMeter
from biosensor_gateway.agent.state import State
from biosensor_gateway.devices.registry import declaration
from biosensor_gateway.page.history import History
from biosensor_gateway.page.models import DeviceState, DeviceView, StreamView

_STATES = {
    State.DISCOVERING.value: DeviceState.SEARCHING,
    State.CONNECTING.value: DeviceState.CONNECTING,
    State.STREAMING.value: DeviceState.STREAMING,
    State.ENABLING.value: DeviceState.NO_DATA,
    State.BACKOFF.value: DeviceState.REFUSED,
    State.STOPPED.value: DeviceState.STOPPED,
}


class Viewer:
    """Describes devices from one status to the next, which it takes to measure rates.

    Parameters
    ----------
    history
        The newest values.
    """

    def __init__(self, history: History) -> None:
        self._history = history
        self._meters: dict[str, RateMeter] = {}

    def devices(self, status: Mapping[str, Any]) -> list[DeviceView]:
        """Describe the devices of a status, see `snapshot`."""
        now = float(status["lsl_time"])
        identities = [_identity(each) for each in status["devices"]]
        topics = _topics(identities)
        return [
            self._device(identity, device, topics, now)
            for identity, device in zip(identities, status["devices"], strict=True)
        ]

    def _device(
        self,
        identity: DeviceIdentity,
        device: Mapping[str, Any],
        topics: Mapping[str, str],
        now: float,
    ) -> DeviceView:
        declared = _declared(identity)
        streams = [
            self._stream(identity, declared[source], source, each, topics, now)
            for source, each in device["streams"].items()
            if source in declared
        ]
        return DeviceView(
            name=device_name(identity),
            sensor=identity.sensor,
            unit=identity.unit,
            title=title_of(identity.sensor),
            participant=identity.participant,
            label=identity.label,
            state=_state(device),
            reason=" ".join((device["error"] or "").split()),
            paused=device["paused"],
            battery_percent=device["battery_percent"],
            connections=device["connections"],
            lost=sum(each.lost or 0 for each in streams),
            streams=streams,
        )

    def _stream(
        self,
        identity: DeviceIdentity,
        spec: StreamSpec,
        source: str,
        counted: Mapping[str, Any],
        topics: Mapping[str, str],
        now: float,
    ) -> StreamView:
        meter = self._meters.setdefault(source, RateMeter())
        meter.note(counted["pushed"], counted["last_stamp"])
        newest = self._history.newest(source)
        age_s = now - newest[0] if newest else None
        is_regular = counted["rate_hz"] > 0
        # What comes when it changes holds until it changes again.
        is_fresh = newest is not None and (not is_regular or now - newest[0] < STALE_AFTER_S)
        return StreamView(
            source_id=source,
            data_name=spec.data_name,
            lsl_name=naming.lsl_name(identity, spec.data_name),
            topic=topics[source],
            content_type=spec.content_type.value,
            channels=[each.label for each in spec.channels],
            units=[str(each.unit) for each in spec.channels],
            rate_hz=meter.rate_hz(now) if is_regular else None,
            nominal_hz=counted["rate_hz"],
            pushed=counted["pushed"],
            lost=counted["lost"],
            age_s=None if age_s is None else max(0.0, age_s),
            is_fresh=is_fresh,
            is_silent=counted["silent"],
            is_signal=spec.content_type not in TYPES_OF_DEVICE,
            values=newest[1] if newest and is_fresh else [],
        )


def _identity(device: Mapping[str, Any]) -> DeviceIdentity:
    return DeviceIdentity(device["sensor"], device["unit"], device["participant"], device["label"])


def _topics(identities: list[DeviceIdentity]) -> dict[str, str]:
    streams = {
        source: (identity, spec.data_name)
        for identity in identities
        for source, spec in _declared(identity).items()
    }
    return {key: f"/{name.name}" for key, name in naming.resolve_topics(streams).items()}


def _declared(identity: DeviceIdentity) -> dict[str, StreamSpec]:
    try:
        streams = declaration(identity.sensor).streams
    except SpecError:
        return {}
    return {naming.source_id(identity, each.data_name): each for each in streams}


def title_of(sensor: str) -> str:
    """Return what people call a kind of sensor; its name, if it is unknown."""
    try:
        return declaration(sensor).title
    except SpecError:
        return sensor


def _state(device: Mapping[str, Any]) -> DeviceState:
    if device["paused"]:
        return DeviceState.PAUSED
    state = _STATES[device["state"]]
    if state is DeviceState.STREAMING and device["worn"] is False:
        return DeviceState.NOT_WORN
    return state
