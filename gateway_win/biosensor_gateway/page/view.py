"""Puts the agent's status into what the page shows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from biosensor_common import naming
from biosensor_common.errors import SpecError
from biosensor_common.quantities import TYPES_OF_DEVICE
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.declared_streams import declared_streams
from biosensor_gateway.agent.pauses.selection import device_name
from biosensor_gateway.agent.rate_meter import STALE_AFTER_S, RateMeter
from biosensor_gateway.agent.status import AgentStatus, DeclaredStream, DeviceStatus, StreamStatus
from biosensor_gateway.page.history import History
from biosensor_gateway.page.models import DeviceView, StreamView
from biosensor_gateway.page.network.models import SeenStreamView
from biosensor_gateway.page.titles import title_of


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

    def devices(
        self, status: AgentStatus, features: Sequence[SeenStreamView] = ()
    ) -> list[DeviceView]:
        """Describe the devices of an agent.

        Parameters
        ----------
        status
        features
            What is computed of streams, theirs and others.
        """
        now = status.lsl_time or 0.0
        declared = [(_identity(each), _declared(each)) for each in status.devices]
        topics = _topics(declared)
        views = [
            self._device(*of_device, device, topics, now)
            for of_device, device in zip(declared, status.devices, strict=True)
        ]
        for view in views:
            own = (each for each in features if each.derived_from in view.streams)
            view.features = [_named(each, topics) for each in own]
        return views

    def _device(
        self,
        identity: DeviceIdentity,
        declared: Mapping[str, DeclaredStream],
        device: DeviceStatus,
        topics: Mapping[str, str],
        now: float,
    ) -> DeviceView:
        streams = {
            source: self._stream(identity, declared[source], source, each, topics[source], now)
            for source, each in device.streams.items()
            if source in declared
        }
        return DeviceView(
            **_facts(device),
            streams=streams,
            name=device_name(identity),
            title=title_of(identity.sensor),
            lost=sum(each.lost for each in streams.values()),
        )

    def _stream(
        self,
        identity: DeviceIdentity,
        stream: DeclaredStream,
        source: str,
        counted: StreamStatus,
        topic: str,
        now: float,
    ) -> StreamView:
        meter = self._meters.setdefault(source, RateMeter())
        meter.note(counted.pushed, counted.last_stamp)
        newest = self._history.newest(source)
        is_regular = counted.nominal_hz > 0
        # What comes when it changes holds until it changes again.
        is_fresh = newest is not None and (not is_regular or now - newest[0] < STALE_AFTER_S)
        return StreamView(
            **dict(counted),
            source_id=source,
            data_name=stream.data_name,
            lsl_name=naming.lsl_name(identity, stream.data_name),
            topic=topic,
            content_type=stream.content_type,
            channels=stream.labels,
            units=stream.units,
            measured_hz=meter.rate_hz(now) if is_regular else None,
            age_s=max(0.0, now - newest[0]) if newest else None,
            is_fresh=is_fresh,
            is_signal=stream.content_type not in TYPES_OF_DEVICE,
            values=newest[1] if newest and is_fresh else [],
        )


def _named(feature: SeenStreamView, topics: Mapping[str, str]) -> SeenStreamView:
    """Give a feature the ROS topic that it has among the streams of all devices."""
    device_topic = topics[feature.derived_from].rpartition("/")[0]
    return feature.model_copy(update={"topic": f"{device_topic}/{feature.data_name}"})


def _facts(device: DeviceStatus) -> dict[str, Any]:
    return {name: value for name, value in device if name not in ("streams", "declared")}


def _identity(device: DeviceStatus) -> DeviceIdentity:
    return DeviceIdentity(device.sensor, device.unit, device.participant, device.label)


def _topics(
    devices: Iterable[tuple[DeviceIdentity, Mapping[str, DeclaredStream]]],
) -> dict[str, str]:
    streams = {
        source: (identity, stream.data_name)
        for identity, declared in devices
        for source, stream in declared.items()
    }
    return {key: f"/{name.name}" for key, name in naming.resolve_topics(streams).items()}


def _declared(device: DeviceStatus) -> dict[str, DeclaredStream]:
    try:
        streams = declared_streams(device.sensor, device.declared)
    except SpecError:
        return {}
    identity = _identity(device)
    return {naming.source_id(identity, each.data_name): each for each in streams}
