"""Reads what the agents have counted, out of their streams ``gateway/counters``."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, cast

from biosensor_common.quantities import ContentType
from biosensor_common.refusal import Refusal
from biosensor_common.refusals import Refusals
from biosensor_gateway.page.network.received import MAX_COUNTERS
from biosensor_gateway.page.network.stream import NetworkStream


def is_counters(stream: NetworkStream) -> bool:
    """Whether an agent of ours tells its counts in it."""
    return stream.is_ours and stream.core.content_type == ContentType.COUNTERS


class Counted(NamedTuple):
    """What an agent tells of one of its streams.

    Attributes
    ----------
    lost
        How many samples never reached it; None if it does not say.
    refused
        What is not passed on as it came now, one sentence each.
    """

    lost: int | None
    refused: tuple[str, ...]


def counted_by_source(streams: Iterable[NetworkStream], refusals: Refusals) -> dict[str, Counted]:
    """Return what agents tell of their streams, by source_id."""
    found: dict[str, Counted] = {}
    for stream in streams:
        # What an agent counted in a recording is of another day.
        if is_counters(stream) and not (stream.header and stream.header.replay):
            found.update(_counted(stream, refusals))
    return found


def _counted(stream: NetworkStream, refusals: Refusals) -> dict[str, Counted]:
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
    return {
        source: _entry(cast("Mapping[str, Any]", entry))
        for source, entry in entries
        if isinstance(entry, Mapping)
    }


def _entry(entry: Mapping[str, Any]) -> Counted:
    lost, refused = entry.get("lost"), entry.get("refused")
    sentences = cast("list[object]", refused) if isinstance(refused, list) else []
    return Counted(lost if isinstance(lost, int) else None, tuple(map(str, sentences)))
