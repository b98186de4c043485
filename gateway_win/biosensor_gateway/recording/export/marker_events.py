"""Parses events from marker streams, in time order."""

from __future__ import annotations

import heapq
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from biosensor_common.naming import AGENT, NODE
from biosensor_common.plausible import finite
from biosensor_gateway.recording.contents.choice import Chosen, merged
from biosensor_gateway.recording.contents.stream import Samples, Stream
from biosensor_gateway.recording.contents.wall_clock import EVENTS
from biosensor_gateway.recording.export.exporter import ExportOptions, Timeline, timeline
from biosensor_gateway.recording.export.runs import BAD_GAP, Gap
from biosensor_gateway.recording.export.tables import SECONDS, quoted, time_column

MARKERS = "markers"
"""Data name of the agent's own markers."""


def marker_streams(chosen: Chosen) -> list[Stream]:
    """Return the marker streams, except the agents' and nodes' own event streams."""
    streams = (each for each in chosen.streams if each.header.is_markers)
    return [each for each in streams if not _is_of_a_program(each)]


def markers(chosen: Chosen) -> Iterator[tuple[float, str]]:
    """Yield time and text of each marker in time order, with channels joined by commas."""
    for _, samples in Chosen(
        chosen.contents, tuple(marker_streams(chosen)), chosen.begin_s, chosen.end_s
    ).merged():
        for time_s, values in zip(samples.times.tolist(), samples.values, strict=True):
            yield time_s, ", ".join(texts(values))


def texts(values: Iterable[str | np.generic]) -> list[str]:
    """Return all channels of a marker as texts."""
    return [each if isinstance(each, str) else str(each.item()) for each in values]


def _is_of_a_program(stream: Stream) -> bool:
    identity = stream.header.identity
    if identity is None or identity.sensor not in {AGENT, NODE}:
        return False
    return stream.header.data_name != MARKERS


# Number of events held back for sorting, and because they may be undone.
_KEPT = 10_000
_LONGEST_NAME = 100
# A marker added in retrospect is at most an hour late.
_MOST_APART_S = 2 * 3600.0
_OF_DEVICES = frozenset(
    {
        "connected",
        "disconnected",
        "gap_start",
        "gap_end",
        "clock_reanchored",
        "settings_changed",
        "off_body",
        "on_body",
        "paused",
        "resumed",
    }
)


@dataclass(slots=True)
class MarkerEvent:
    """An event."""

    onset_s: float  # Seconds since the timeline's zero.
    name: str  # Empty if only `text` is known.
    text: str  # As recorded.
    # The only participant concerned; empty for all participants of the stream.
    participant: str = ""
    # id, undoes: number of one of the agent's markers, and of the marker that it undoes.
    id: int | None = None
    undoes: int | None = None
    undone: bool = False
    note: str = ""  # Free text of one of the agent's markers.
    duration_s: float | None = None  # None for an instantaneous event.


def gap_event(stream: Stream, gap: Gap, timeline: Timeline) -> MarkerEvent:
    """Return a gap as an event of the sensor's participant."""
    begin_s, end_s = timeline.since_zero(
        np.array([gap.begin_s, gap.begin_s + gap.length_s])
    ).tolist()
    identity = stream.header.identity
    whose = identity.participant if identity else ""
    length_s = end_s - begin_s
    return MarkerEvent(begin_s, BAD_GAP, gap.text, whose, note=gap.text, duration_s=length_s)


def is_left_out(stream: Stream) -> bool:
    """Whether it is one of our own streams without participants' data: counters, node events."""
    identity = stream.header.identity
    if identity is None or identity.sensor not in (AGENT, NODE):
        return False
    return identity.sensor == NODE or stream.header.data_name not in (EVENTS, MARKERS)


def marker_events(stream: Stream, samples: Samples, timeline: Timeline) -> Iterator[MarkerEvent]:
    """Yield the events in the samples of a marker stream."""
    identity = stream.header.identity
    kind = stream.header.data_name if identity is not None and identity.sensor == AGENT else ""
    onsets = timeline.since_zero(samples.times).tolist()
    for place, onset_s in enumerate(onsets):
        told = texts(samples.values[place])
        whole = told[0] if len(told) == 1 else json.dumps(told, ensure_ascii=False)
        event = MarkerEvent(onset_s, "", whole)
        if kind:
            content = _content(event.text)
            if kind == EVENTS and content.get("event") not in _OF_DEVICES:
                continue
            _tell(event, content)
            event.onset_s = _told_onset(samples, place, content, timeline, onset_s)
        elif len(whole) <= _LONGEST_NAME:
            event.name = ", ".join(told)
        yield event


def _tell(event: MarkerEvent, content: Mapping[str, Any]) -> None:
    event.name = str(content.get("marker") or content.get("event") or "")
    event.participant = str(content.get("participant") or "")
    event.note = str(content.get("note") or "")
    event.id = _whole(content.get("id"))
    event.undoes = _whole(content.get("of"))


def _told_onset(
    samples: Samples, place: int, content: Mapping[str, Any], timeline: Timeline, onset_s: float
) -> float:
    """Return the time in the marker's text, because timestamps are forced to ascend."""
    told = finite(content.get("lsl_time"))
    if told is None:
        return onset_s
    time_s, stamp_s = float(samples.times[place]), float(samples.stamps[place])
    if abs(told - stamp_s) > _MOST_APART_S:
        return onset_s
    return float(timeline.since_zero(np.array([time_s - stamp_s + told]))[0])


def _content(text: str) -> Mapping[str, Any]:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return cast("Mapping[str, Any]", content) if isinstance(content, dict) else {}


def _whole(value: object) -> int | None:
    return value if isinstance(value, int) else None


def write_marker_table(
    chosen: Chosen, options: ExportOptions, path: Path, gaps: Iterable[tuple[Stream, Gap]] = ()
) -> None:
    """Write a new CSV table with all events of all marker streams, and with gaps.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    line = timeline(chosen, options.clock)
    streams = [each for each in chosen.streams if each.header.is_markers and not is_left_out(each)]

    def all_of_them() -> Iterator[tuple[Stream, MarkerEvent]]:
        for stream, samples in merged(streams, chosen.begin_s, chosen.end_s):
            for each in marker_events(stream, samples, line):
                yield stream, each

    with path.open("xb") as file:
        heads = [SECONDS, time_column(options.clock)]
        heads += ["marker", "note", "undone", "participant", "stream"]
        file.write(quoted([heads]))
        missing = ((stream, gap_event(stream, gap, line)) for stream, gap in gaps)
        for stream, each in in_order(all_of_them(), missing):
            told = (each.name or each.text, each.note, "yes" if each.undone else "no")
            times = (round(each.onset_s, 6), line.begin_s + each.onset_s)
            row = (*times, *told, each.participant, stream.header.title)
            file.write(quoted([row]))


def in_order(
    events: Iterable[tuple[Stream, MarkerEvent]],
    gaps: Iterable[tuple[Stream, MarkerEvent]] = (),
) -> Iterator[tuple[Stream, MarkerEvent]]:
    """Sort events by time, and flag those that later markers undo."""
    events = heapq.merge(
        events,
        sorted(gaps, key=lambda each: each[1].onset_s),
        key=lambda each: each[1].onset_s,
    )
    kept: list[_Kept] = []
    newest: dict[tuple[int, int], MarkerEvent] = {}
    for order, (stream, event) in enumerate(events):
        if event.undoes is not None:
            if undone := newest.get((stream.number, event.undoes)):
                undone.undone = True
        elif event.id is not None:
            newest[stream.number, event.id] = event
        heapq.heappush(kept, _Kept(event.onset_s, order, stream, event))
        if len(kept) > _KEPT:
            first = heapq.heappop(kept)
            _forget(newest, first)
            yield first.stream, first.event
    while kept:
        first = heapq.heappop(kept)
        yield first.stream, first.event


class _Kept(NamedTuple):
    onset_s: float
    order: int
    stream: Stream
    event: MarkerEvent


def _forget(newest: dict[tuple[int, int], MarkerEvent], kept: _Kept) -> None:
    number = kept.event.id
    if number is not None and newest.get((kept.stream.number, number)) is kept.event:
        del newest[kept.stream.number, number]
