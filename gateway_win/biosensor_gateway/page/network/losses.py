"""Reads what the agents have counted, out of their streams ``gateway/counters``."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any, cast

from biosensor_common.quantities import ContentType
from biosensor_common.refusal import Refusal
from biosensor_common.refusals import Refusals
from biosensor_gateway.page.network.received import MAX_COUNTERS
from biosensor_gateway.page.network.stream import NetworkStream


def is_counters(stream: NetworkStream) -> bool:
    """Whether an agent of ours tells its counts in it."""
    return stream.is_ours and stream.core.content_type == ContentType.COUNTERS


def lost_by_source(streams: Iterable[NetworkStream], refusals: Refusals) -> dict[str, int]:
    """Return how many samples never reached their agent, by source_id."""
    found: dict[str, int] = {}
    for stream in streams:
        # What an agent counted in a recording is of another day.
        if is_counters(stream) and not (stream.header and stream.header.replay):
            found.update(_lost(stream, refusals))
    return found


def _lost(stream: NetworkStream, refusals: Refusals) -> dict[str, int]:
    text, about = stream.received.raw, stream.core.name
    try:
        counted: object = json.loads(text[:MAX_COUNTERS]) if text else {}
    except (ValueError, RecursionError) as error:
        refusals.refuse(Refusal.NO_COUNTS, about=about, why=error)
        return {}
    if not isinstance(counted, Mapping):
        refusals.refuse(Refusal.NO_COUNTS, about=about, why="they are no object")
        return {}
    entries = cast("Mapping[str, Any]", counted).items()
    return {source: count for source, entry in entries if (count := _count(entry)) is not None}


def _count(entry: object) -> int | None:
    count = cast("Mapping[str, Any]", entry).get("lost") if isinstance(entry, Mapping) else None
    return count if isinstance(count, int) else None
