"""Converts the streams of the network to the page's models."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Collection, Mapping, Sequence
from itertools import groupby
from typing import Any, cast

import numpy as np

from biosensor_common import naming
from biosensor_common.quantities import TYPES_OF_DEVICE, ChannelFormat, ChannelRole
from biosensor_common.refusal import Refusal
from biosensor_common.stream_header import CoreFields, StreamHeader, stale_after_s
from biosensor_gateway.agent.device_states import STATE_WORDS
from biosensor_gateway.devices.registry import sensor_title
from biosensor_gateway.page.downsampling import DRAWN_CHANNELS, chosen
from biosensor_gateway.page.live_feed import is_of_now
from biosensor_gateway.page.models import (
    NetworkView,
    SeenDeviceView,
    SeenState,
    SeenStreamView,
    TextView,
    WindowView,
)
from biosensor_gateway.page.network.network_stream import NetworkStream
from biosensor_gateway.page.network.stream_list import (
    MAX_INLETS,
    Counted,
    StreamList,
    counted_by_source,
    is_counters,
)
from biosensor_gateway.streaming.counters import GATEWAY

_BYTES = {
    ChannelFormat.INT8: 1,
    ChannelFormat.INT16: 2,
    ChannelFormat.DOUBLE64: 8,
    ChannelFormat.INT64: 8,
}
_STAMP_BYTES = 8
_MOST_PROBLEMS = 20
_AGENT = "Capture agent"
_REPLAY = "↻ Replay"
# A device has the first of these states that any of its streams has.
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
MAX_NAME = 120
MAX_LABEL = 40
MAX_ENTRY = 200
_SHOWN_KEYS = ("event", "marker", "note", "device", "state", "stream", "reason")


class Viewer:
    """Converts successive states of the network to views."""

    def __init__(self) -> None:
        self._begun_s: float | None = None
        self._named: frozenset[tuple[int, StreamHeader]] = frozenset()
        self._topics: dict[int, str] = {}
        self._keys: dict[str, str] = {}

    def view(
        self, listing: StreamList, not_received: int, wanted: Collection[str], now: float
    ) -> NetworkView:
        """Return the view of all streams.

        Parameters
        ----------
        wanted
            Keys of the channels that browsers show, see `key_of`.
        now
            Local LSL time.
        """
        self._begun_s = now if self._begun_s is None else self._begun_s
        streams = list(listing.streams.values())
        self._name(streams)
        counted = counted_by_source(streams, listing.refusals)
        lost = {source: e.lost for source, e in counted.items() if e.lost is not None}
        windows = chosen(wanted)
        self._keys = {each.core.source_id: str(each.number) for each in streams}
        views = {
            each.number: self._stream(each, counted, windows.get(each.number, set()), now)
            for each in streams
        }
        known = sorted((each for each in streams if each.header), key=group_of)
        grouped = [list(parts) for _, parts in groupby(known, key=group_of)]
        for parts in grouped:
            _forget_values_of_silent(parts, views)
        return NetworkView(
            made_s=now,
            searched_s=now - self._begun_s,
            inlets=sum(each.receiver is not None for each in streams),
            most_inlets=MAX_INLETS,
            not_received=not_received,
            problems=_problems(listing),
            devices=[device_view(parts, views, lost) for parts in grouped],
        )

    def _name(self, streams: Sequence[NetworkStream]) -> None:
        """Resolve ROS topics as a node with the same streams would."""
        named = frozenset((each.number, each.header) for each in streams if each.header)
        if named != self._named:
            self._named = named
            claims = {number: (header.identity, header.data_name) for number, header in named}
            resolved = naming.resolve_topics(claims)
            self._topics = {number: f"/{topic.name}" for number, topic in resolved.items()}

    def _stream(
        self, stream: NetworkStream, counted: dict[str, Counted], firsts: set[int], now: float
    ) -> SeenStreamView:
        core, received = stream.core, stream.received
        is_text = core.format is ChannelFormat.STRING
        state, silent_s = _state(stream, now)
        is_fresh = state in (SeenState.STREAMING, SeenState.WAITING) and not _is_over(stream, now)
        # The last values of a device that does not send any more are of the past.
        is_fresh = is_fresh and not (stream.is_ours and _is_away(stream, counted))
        first = _window(stream, 0, is_fresh=is_fresh)
        count, is_estimated = _lost(stream, counted)
        return SeenStreamView(
            source_id=str(stream.number),
            data_name=readable(stream.header.data_name if stream.header else core.content_type),
            lsl_name=readable(core.name),
            topic=self._topics.get(stream.number, ""),
            content_type=readable(core.content_type),
            channels=[] if is_text else first.channels,
            units=[] if is_text else first.units,
            values=[] if is_text else first.values,
            measured_hz=received.meter.rate_hz(now) if core.rate and is_fresh else None,
            nominal_hz=core.rate,
            lost=count,
            age_s=None if state is SeenState.LISTED else received.age_s(now),
            is_fresh=is_fresh,
            is_signal=core.content_type not in TYPES_OF_DEVICE,
            seen=state,
            silent_s=silent_s,
            note=_note(stream, counted),
            is_lost_estimated=is_estimated,
            is_text=is_text,
            texts=[] if is_counters(stream) else _texts(stream, now),
            channel_count=core.channel_count,
            windows={
                each: _window(stream, each, is_fresh=is_fresh)
                for each in firsts if 0 < each < core.channel_count
            },
            bytes_per_s=_bytes_per_s(core),
            derived_from=self._source_of(stream),
        )  # fmt: skip

    def _source_of(self, stream: NetworkStream) -> str:
        derived = stream.header.derived if stream.header else None
        return self._keys.get(derived.source_id, derived.source_id) if derived else ""


def _state(stream: NetworkStream, now: float) -> tuple[SeenState, float]:
    """Return the state of a stream, and how long it has sent nothing."""
    heard_s, core, receiver = stream.received.heard_s, stream.core, stream.receiver
    if stream.is_gone(now):
        return SeenState.GONE, now - (stream.seen_s if heard_s is None else heard_s)
    if stream.header is None or receiver is None:
        return (SeenState.READING if stream.header is None else SeenState.LISTED), 0.0
    silent_s = receiver.age_s if heard_s is None else now - heard_s
    if not core.rate:
        return SeenState.WAITING, silent_s
    if silent_s > stale_after_s(core.rate):
        return SeenState.SILENT, silent_s
    return (SeenState.OPENING if heard_s is None else SeenState.STREAMING), silent_s


def _is_over(stream: NetworkStream, now: float) -> bool:
    """Whether the newest value is outdated although the stream is present."""
    core, age_s = stream.core, stream.received.age_s(now)
    derived = stream.header.derived if stream.header else None
    if derived is not None:
        return age_s is None or age_s > derived.holds_s
    is_signal = core.content_type not in TYPES_OF_DEVICE
    return not core.rate and not is_of_now(age_s, nominal_hz=0.0, is_signal=is_signal)


def _forget_values_of_silent(
    streams: Sequence[NetworkStream], views: dict[int, SeenStreamView]
) -> None:
    """Remove the values of our devices whose regular streams are all silent."""
    rated = {views[each.number].seen for each in streams if each.core.rate}
    if streams[0].is_ours and rated and rated <= {SeenState.SILENT, SeenState.GONE}:
        for each in streams:
            views[each.number] = views[each.number].outdated()


def _bytes_per_s(core: CoreFields) -> float:
    sample = core.channel_count * _BYTES.get(core.format, 4) + _STAMP_BYTES
    return core.rate * sample


def _window(stream: NetworkStream, first: int, *, is_fresh: bool) -> WindowView:
    header, values = stream.header, stream.received.values
    end = min(first + DRAWN_CHANNELS, stream.core.channel_count)
    labels = header.labels[first:end] if header else ()
    units = header.units[first:end] if header else ()
    # nothing is dropped: the page has a window of channels
    newest = values[first:end] if is_fresh else np.empty(0)
    numbers = range(first + 1, end + 1)
    names = [readable(each, MAX_LABEL) for each in labels] or [""] * len(numbers)
    return WindowView(
        channels=[name or str(number) for name, number in zip(names, numbers, strict=True)],
        units=[readable(each, MAX_LABEL) or "none" for each in units] or ["none"] * len(numbers),
        # JSON has neither NaN nor infinity.
        values=[float(each) if np.isfinite(each) else None for each in newest],
    )


def _is_away(stream: NetworkStream, counted: dict[str, Counted]) -> bool:
    known = counted.get(stream.core.source_id)
    return known is not None and bool(known.away)


def _lost(stream: NetworkStream, counted: dict[str, Counted]) -> tuple[int | None, bool]:
    """Return the number of lost samples, and whether it is estimated from the stamps."""
    if stream.is_ours:
        known = counted.get(stream.core.source_id)
        return (known.lost if known else None), False
    is_known = stream.core.rate > 0 and stream.received.count > 0
    return (stream.received.missing if is_known else None), True


def _texts(stream: NetworkStream, now: float) -> list[TextView]:
    return [
        TextView(
            text=entry_of(each.text, is_ours=stream.is_ours), age_s=max(0.0, now - each.time_s)
        )
        for each in reversed(stream.received.texts)
    ]


def _note(stream: NetworkStream, counted: dict[str, Counted]) -> str:
    """Return the problems of a stream, as observed here and as reported by its agent."""
    counts = counted.get(stream.core.source_id) if stream.is_ours else None
    own = stream.note or _clock_note(stream)
    refused = counts.refused if counts else ()
    state = counts.away if counts else ""
    away = f"its sensor does not send: {STATE_WORDS.get(state, state)}" if state else ""
    return readable("; ".join(each for each in (away, own, *refused) if each), 400)


def _clock_note(stream: NetworkStream) -> str:
    is_known = stream.receiver is not None and stream.receiver.correction is not None
    return Refusal.BY_ARRIVAL.message() if is_known and stream.received.placer.is_by_arrival else ""


def _problems(listing: StreamList) -> list[str]:
    problems = [readable(each.sentence_about, 400) for each in listing.refusals.present]
    more = len(problems) - _MOST_PROBLEMS
    return [*problems[:_MOST_PROBLEMS], *([f"and {more} more"] if more > 0 else [])]


def group_of(stream: NetworkStream) -> tuple[str, ...]:
    """Return a key that is equal for streams of one device, and sorts devices before programs."""
    header = stream.header
    if header is None or header.foreign:
        return ("other", _played(stream), stream.core.hostname, stream.core.name)
    identity = header.identity
    who = (identity.participant, identity.sensor, identity.unit, identity.label)
    return ("program" if identity.sensor == GATEWAY.name else "device", _played(stream), *who)


def device_view(
    streams: Sequence[NetworkStream], views: Mapping[int, SeenStreamView], lost: Mapping[str, int]
) -> SeenDeviceView:
    """Return the view of one device from its streams, at least one."""
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
    """Return a sort key: signals of the body, the fastest first; then the rest, text last."""
    return (stream.is_text, not stream.is_signal, -stream.nominal_hz, stream.data_name)


def _played(stream: NetworkStream) -> str:
    """Return the recording that a stream is replayed from; empty for a live stream."""
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
    """Return the newest value of the channel with a role; None if outdated or unknown."""
    for stream in streams:
        roles = stream.header.roles if stream.header else ()
        values = stream.received.values
        if role in roles and len(values) == len(roles) and views[stream.number].is_fresh:
            value = float(values[roles.index(role)])
            if np.isfinite(value):
                return value
    return None  # nothing is dropped: it looks at a copy


def readable(text: str, most: int = MAX_NAME) -> str:
    r"""Escape characters that are not printable, and shorten a text that is too long.

    They are written as ``\x0a`` or ``\u202e``, so that a name is harmless when it is copied into
    a terminal.
    """
    shown = "".join(each if each.isprintable() else _escaped(each) for each in text[: most + 1])
    return shown if len(shown) <= most else f"{shown[: most - 1]}…"


def entry_of(text: str, *, is_ours: bool) -> str:
    """Return the text of an entry of a text stream; for an agent's JSON, the values for people."""
    if is_ours:
        with contextlib.suppress(ValueError, RecursionError):
            content = json.loads(text)
            if isinstance(content, dict):
                entry = cast("dict[str, Any]", content)
                parts = [entry[key] for key in _SHOWN_KEYS if isinstance(entry.get(key), str)]
                text = ": ".join(parts) or text
    return readable(text, MAX_ENTRY)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape", "surrogatepass").decode("ascii")
