"""The real LabRecorder, and what it has written."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyxdf

from biosensor_common import naming
from biosensor_common.spec import DeviceIdentity
from tests.rigs.lab_recorder import LabRecorder
from tests.system.tracks import NS_PER_S, Track

_load_xdf: Callable[..., tuple[list[dict[str, Any]], dict[str, Any]]] = cast("Any", pyxdf).load_xdf


def recording(path: Path, source_ids: Iterable[str]) -> LabRecorder:
    """Record these streams in a block; all of them are open when it begins."""
    predicates = [f"source_id='{source_id}'" for source_id in source_ids]
    return LabRecorder(path, predicates, len(predicates))


@dataclass(frozen=True)
class RecordedStream:
    """One stream of an XDF file."""

    track: Track
    # LabRecorder's measurements of the sender's clock against its own, in seconds.
    clock_offsets: tuple[float, ...]


def read(path: Path, system_minus_lsl_ns: int) -> Mapping[str, RecordedStream]:
    """Return the streams of an XDF file by the stamped topics that they fill.

    Their stamps are those of the senders, uncorrected: on one computer all have one clock,
    so that the measured offsets between them are nothing but noise.
    """
    streams, _ = _load_xdf(str(path), synchronize_clocks=False, dejitter_timestamps=False)
    return {f"/{_topic(stream['info'])}_stamped": _recorded(stream, system_minus_lsl_ns)
            for stream in streams}  # fmt: skip


def _recorded(stream: Mapping[str, Any], system_minus_lsl_ns: int) -> RecordedStream:
    info = stream["info"]
    channels = int(info["channel_count"][0])
    stamps = np.asarray(stream["time_stamps"], np.float64)
    kind = object if info["channel_format"] == ["string"] else np.float64
    values = np.array(stream["time_series"], kind).reshape(len(stamps), channels)
    track = Track(
        np.rint(stamps * NS_PER_S).astype(np.int64) + system_minus_lsl_ns,
        values,
        _texts(info, channels, "label"),
        _texts(info, channels, "unit"),
    )
    return RecordedStream(track, tuple(stream["clock_values"]))


def _topic(info: Mapping[str, Any]) -> str:
    """Return the name of the unstamped topic."""
    blocks = _description(info).get("biosensor")
    if blocks is None:
        fields = (info[name][0] or "" for name in ("name", "type", "source_id", "hostname"))
        return naming.topic(*naming.foreign_identity(*fields))
    names = ("sensor", "unit", "participant", "label")
    identity = DeviceIdentity(*(blocks[0][name][0] or "" for name in names))
    return naming.topic(identity, blocks[0]["data_name"][0])


def _texts(info: Mapping[str, Any], channels: int, name: str) -> tuple[str, ...]:
    """Return what is said of each channel."""
    description = _description(info)
    if "channels" not in description:
        return ("",) * channels
    return tuple(channel[name][0] or "" for channel in description["channels"][0]["channel"])


def _description(info: Mapping[str, Any]) -> Mapping[str, Any]:
    return info["desc"][0] or {}
