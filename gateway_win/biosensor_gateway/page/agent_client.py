"""Receives the agent's feed, and converts its status to the page's models."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from biosensor_common import naming
from biosensor_common.errors import SpecError
from biosensor_common.quantities import TYPES_OF_DEVICE
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.control import CONTROL_FILE, HOST, json_object, line
from biosensor_gateway.agent.device_states import described, device_name, is_sending
from biosensor_gateway.agent.feed_frames import (
    HEAD,
    FrameKind,
    Samples,
    read_count,
    read_samples,
)
from biosensor_gateway.agent.rate_meter import RateMeter
from biosensor_gateway.agent.single_instance import is_held
from biosensor_gateway.agent.status import (
    AgentStatus,
    DeclaredStream,
    DeviceStatus,
    StreamStatus,
    declared_streams,
)
from biosensor_gateway.devices.registry import sensor_title
from biosensor_gateway.page.live_feed import History, is_of_now
from biosensor_gateway.page.models import DeviceView, SeenStreamView, StreamView
from biosensor_gateway.system import state_file

RETRY_S = 0.25
_READING = (
    "pylsl",
    "numpy",
    "biosensor_gateway.page.downsampling",
)
SILENT_AFTER_S = 4.0
"""The agent sends its status every second; after this time without one it is stuck."""


class AgentLink:
    """Receives the feed of a state folder's agent.

    Parameters
    ----------
    on_status
        Called with the agent's status, once a second, and with None when the agent is gone.
    on_dropped
        Called with the number of samples that this program was too slow to receive.
    """

    def __init__(
        self,
        folder: Path,
        on_status: Callable[[AgentStatus | None], None],
        on_samples: Callable[[Samples], None],
        on_dropped: Callable[[int], None],
    ) -> None:
        self._folder = folder
        self._on_status = on_status
        self._on_samples = on_samples
        self._on_dropped = on_dropped
        self._can_read = False

    async def run(self) -> None:
        """Receive until cancelled."""
        while True:
            # Only while the lock is held: another program may use the port of a killed agent.
            if is_held(self._folder):
                with contextlib.suppress(OSError, ValueError, EOFError, TimeoutError):
                    await self._follow()
                self._on_status(None)
            await asyncio.sleep(RETRY_S)

    async def _follow(self) -> None:
        place = json_object(state_file.read(self._folder / CONTROL_FILE).encode()) or {}
        reader, writer = await asyncio.open_connection(HOST, int(place.get("port", 0)))
        try:
            writer.write(line({"token": place.get("token"), "command": "feed"}))
            async with asyncio.timeout(SILENT_AFTER_S):
                answer = json_object(await reader.readline())
            if answer is None or answer.get("ok") is not True:
                _warn("the agent shows nothing", answer=answer)
                return
            while True:
                async with asyncio.timeout(SILENT_AFTER_S):
                    length, kind = HEAD.unpack(await reader.readexactly(HEAD.size))
                    content = await reader.readexactly(length)
                self._take(kind, content)
                if kind == FrameKind.STATUS and not self._can_read:
                    self._can_read = await asyncio.to_thread(_load_reading)
        finally:
            writer.transport.abort()

    def _take(self, kind: int, content: bytes) -> None:
        if kind == FrameKind.STATUS:
            self._on_status(AgentStatus.model_validate_json(content))
        elif kind == FrameKind.SAMPLES:
            self._on_samples(read_samples(content))
        elif kind == FrameKind.DROPPED:
            self._on_dropped(read_count(content))


def _load_reading() -> bool:
    """Import the modules for samples, in a thread while the page shows devices already."""
    for name in _READING:
        importlib.import_module(name)
    return True


def _warn(event: str, **facts: object) -> None:
    # Imported late: structlog takes a fifth of a second, and the page shows devices before.
    import structlog

    structlog.get_logger("biosensor_gateway.page").warning(event, **facts)


_OF_NOW = ("worn", "battery_percent", "clock")
"""Fields that are outdated while a device does not send."""


class Viewer:
    """Converts each status of an agent to views of its devices, with measured rates."""

    def __init__(self, history: History) -> None:
        self._history = history
        self._meters: dict[str, RateMeter] = {}

    def devices(
        self, status: AgentStatus, features: Sequence[SeenStreamView] = ()
    ) -> list[DeviceView]:
        """Return the views of an agent's devices.

        Parameters
        ----------
        features
            Features on the network, of these and of other devices.
        """
        now = status.lsl_time or 0.0
        declared = [(_identity(each), _declared(each)) for each in status.devices]
        topics = _topics(declared)
        views = [
            self._device(*of_device, device, topics, now)
            for of_device, device in zip(declared, status.devices, strict=True)
        ]
        names = Counter(view.name for view in views)
        for view, (identity, _) in zip(views, declared, strict=True):
            if names[view.name] > 1:
                view.name = described(identity)
            own = (each for each in features if each.derived_from in view.streams)
            view.features = [_named(each, topics, is_fresh=view.is_sending) for each in own]
        return views

    def _device(
        self,
        identity: DeviceIdentity,
        declared: Mapping[str, DeclaredStream],
        device: DeviceStatus,
        topics: Mapping[str, str],
        now: float,
    ) -> DeviceView:
        sends = is_sending(device.state, paused=device.paused)
        streams = {
            source: self._stream(
                identity, declared[source], source, each, topics[source], now, is_sending=sends
            )
            for source, each in device.streams.items()
            if source in declared
        }
        return DeviceView(
            **_facts(device, sends=sends),
            is_sending=sends,
            streams=streams,
            name=device_name(identity),
            title=sensor_title(identity.sensor),
            lost=sum(each.lost for each in streams.values()) if sends else None,
        )

    def _stream(
        self,
        identity: DeviceIdentity,
        stream: DeclaredStream,
        source: str,
        counted: StreamStatus,
        topic: str,
        now: float,
        *,
        is_sending: bool,
    ) -> StreamView:
        meter = self._meters.setdefault(source, RateMeter(counted.nominal_hz))
        meter.note(counted.pushed, counted.last_stamp)
        rate_hz = meter.rate_hz(now)
        newest = self._history.newest(source)
        # What the agent sent before this program received it has no values here.
        sent_s = counted.last_stamp if counted.pushed else None
        newest_s = newest[0] if newest else sent_s
        age_s = None if newest_s is None else max(0.0, now - newest_s)
        nominal_hz, is_signal = counted.nominal_hz, stream.content_type not in TYPES_OF_DEVICE
        is_regular = nominal_hz > 0
        is_fresh = is_sending and is_of_now(age_s, nominal_hz=nominal_hz, is_signal=is_signal)
        return StreamView(
            **dict(counted),
            source_id=source,
            data_name=stream.data_name,
            lsl_name=naming.lsl_name(identity, stream.data_name),
            topic=topic,
            content_type=stream.content_type,
            channels=stream.labels,
            units=stream.units,
            measured_hz=rate_hz if is_regular and is_sending else None,
            age_s=age_s,
            is_fresh=is_fresh,
            is_signal=is_signal,
            values=newest[1] if newest and is_fresh else [],
        )


def _named(feature: SeenStreamView, topics: Mapping[str, str], *, is_fresh: bool) -> SeenStreamView:
    """Return a feature with its ROS topic, and without values if its device does not send."""
    device_topic = topics[feature.derived_from].rpartition("/")[0]
    shown = feature if is_fresh else feature.outdated()
    return shown.model_copy(update={"topic": f"{device_topic}/{feature.data_name}"})


def _facts(device: DeviceStatus, *, sends: bool) -> dict[str, Any]:
    facts = {name: value for name, value in device if name not in ("streams", "declared")}
    return facts if sends else facts | dict.fromkeys(_OF_NOW)


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
