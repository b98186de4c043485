"""Keeps how far a replay is that was begun on the page, and what it sends."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from biosensor_common import naming
from biosensor_common.quantities import TYPES_OF_DEVICE, ChannelRole
from biosensor_common.spec import DeviceIdentity
from biosensor_gateway.agent.feed_frames import Samples
from biosensor_gateway.agent.rate_meter import RateMeter
from biosensor_gateway.devices.registry import sensor_title
from biosensor_gateway.page.history import is_of_now
from biosensor_gateway.page.replay_models import (
    ReplayedDeviceView,
    ReplayedStreamView,
    ReplayView,
)
from biosensor_gateway.page.traces import Traces

if TYPE_CHECKING:
    # They bring numpy and LSL, and the page begins without them.
    from biosensor_gateway.recording.replay.told import PlayedStream, ReplayProgress


class Replayed:
    """Describes the replay, and keeps its newest samples; on the loop of the server alone.

    Parameters
    ----------
    traces
        Where its samples go, to be drawn like all others.
    """

    def __init__(self, traces: Traces) -> None:
        self._traces = traces
        self._view = ReplayView()
        self._streams: Sequence[PlayedStream] = ()
        self._meters: dict[str, RateMeter] = {}
        self._counts: dict[str, int] = {}

    @property
    def is_running(self) -> bool:
        """Whether there is one, or will be in a moment."""
        return self._view.is_running

    def begin(self, file: str, speed: float, *, loop: bool) -> None:
        """Show a replay that is being opened."""
        self._view = ReplayView(is_running=True, file=file, speed=speed, loop=loop)

    def show(self, streams: Sequence[PlayedStream]) -> None:
        """Take in what is played."""
        self._streams = streams
        self._meters = {each.source_id: RateMeter() for each in streams}
        self._counts = dict.fromkeys(self._meters, 0)

    def take(self, samples: Samples) -> None:
        """Keep what was sent."""
        source_id = samples.source_id
        if source_id in self._counts and len(samples.stamps):
            self._counts[source_id] += len(samples.stamps)
            self._meters[source_id].note(self._counts[source_id], float(samples.stamps[-1]))
            self._traces.take(samples)

    def note(self, progress: ReplayProgress, *, is_playing: bool) -> None:
        """Take in how far it is."""
        self._view = self._view.model_copy(
            update={
                "is_playing": is_playing,
                "lap": progress.lap,
                "position_s": progress.position_s,
                "length_s": progress.length_s,
                "sent": progress.sent,
                "received": progress.received,
                "stream_count": progress.streams,
                "said": progress.said,
            }
        )

    def end(self) -> None:
        """Show it as ended; nothing that it has sent is shown any more."""
        self._traces.history.forget(self._counts)
        self._streams, self._meters, self._counts = (), {}, {}
        self._view = self._view.model_copy(update={"is_running": False, "is_playing": False})

    def view(self, now: float) -> ReplayView:
        """Describe it at an LSL time in seconds."""
        if not self._streams:
            return self._view
        topics = self._topics()
        known = sorted((each for each in self._streams if each.channels), key=_device_of)
        devices = [
            self._device(who, list(parts), topics, now) for who, parts in groupby(known, _device_of)
        ]
        return self._view.model_copy(update={"devices": devices})

    def _topics(self) -> dict[str, str]:
        """Resolve ROS topics as a node does that sees these streams alone."""
        claims = {
            each.source_id: (
                DeviceIdentity(each.sensor, each.unit, each.participant, each.label),
                each.data_name,
            )
            for each in self._streams
            if each.is_ours
        }
        return {key: f"/{name.name}" for key, name in naming.resolve_topics(claims).items()}

    def _device(
        self, who: tuple[str, ...], streams: list[PlayedStream], topics: dict[str, str], now: float
    ) -> ReplayedDeviceView:
        first = streams[0]
        return ReplayedDeviceView(
            name=f"replay of {'/'.join(each for each in who if each)}",
            title=sensor_title(first.sensor),
            unit=first.unit,
            participant=first.participant,
            label=first.label,
            battery_percent=self._battery(streams),
            streams={
                each.source_id: self._stream(each, topics, now)
                for each in sorted(streams, key=_rank)
            },
        )

    def _stream(
        self, stream: PlayedStream, topics: dict[str, str], now: float
    ) -> ReplayedStreamView:
        newest = self._traces.history.newest(stream.source_id)
        age_s = max(0.0, now - newest[0]) if newest else None
        is_regular, is_signal = stream.nominal_hz > 0, stream.content_type not in TYPES_OF_DEVICE
        is_fresh = is_of_now(age_s, is_regular=is_regular, is_signal=is_signal)
        meter = self._meters[stream.source_id]
        return ReplayedStreamView(
            source_id=stream.source_id,
            data_name=stream.data_name,
            lsl_name=stream.lsl_name,
            topic=topics.get(stream.source_id, ""),
            content_type=stream.content_type,
            channels=stream.channels,
            units=stream.units,
            nominal_hz=stream.nominal_hz,
            is_empty=stream.is_empty,
            measured_hz=meter.rate_hz(now) if is_regular else None,
            age_s=age_s,
            is_fresh=is_fresh,
            is_signal=is_signal,
            values=newest[1] if newest and is_fresh else [],
        )

    def _battery(self, streams: Sequence[PlayedStream]) -> float | None:
        for each in streams:
            if ChannelRole.STATE_OF_CHARGE in each.roles:
                newest = self._traces.history.newest(each.source_id)
                return newest[1][each.roles.index(ChannelRole.STATE_OF_CHARGE)] if newest else None
        return None


def _rank(stream: PlayedStream) -> tuple[object, ...]:
    """Order: what was measured on the body, the fastest first; then the rest."""
    return (stream.content_type in TYPES_OF_DEVICE, -stream.nominal_hz, stream.data_name)


def _device_of(stream: PlayedStream) -> tuple[str, ...]:
    return (stream.participant, stream.sensor, stream.unit, stream.label)
