"""What LabRecorder wrote in a lab of many computers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyxdf
from numpy.typing import NDArray

from tests.faults.scenarios.many_computers import Stream
from tests.rigs.hosts.recordings import Recording
from tests.rigs.hosts.sites import CLOCK_OFFSETS_S, DESK, unix_s

_load_xdf: Callable[..., tuple[list[dict[str, Any]], dict[str, Any]]] = cast("Any", pyxdf).load_xdf


def recorded(path: Path, streams: Iterable[Stream]) -> dict[Stream, Recording]:
    """Return the numbers of each stream; the arrival of a sample is its stamp, in Unix time."""
    found = _by_stream(path, streams)
    return {
        each: _recording(each.pc, content)
        for each, content in found.items()
        if content["info"]["channel_format"] != ["string"]
    }


def clock_errors_s(path: Path, streams: Iterable[Stream]) -> dict[str, NDArray[np.float64]]:
    """Return by how much LabRecorder mismeasured the clock of each computer, all its streams."""
    errors: dict[str, list[float]] = {}
    for each, content in _by_stream(path, streams).items():
        true_s = CLOCK_OFFSETS_S[DESK] - CLOCK_OFFSETS_S[each.pc]
        errors.setdefault(each.pc, []).extend(v - true_s for v in content["clock_values"])
    return {pc: np.array(values) for pc, values in errors.items()}


def _by_stream(path: Path, streams: Iterable[Stream]) -> Mapping[Stream, Mapping[str, Any]]:
    contents, _ = _load_xdf(str(path), synchronize_clocks=False, dejitter_timestamps=False)
    ids = [content["info"]["source_id"][0] for content in contents]
    assert len(set(ids)) == len(ids), "a stream was recorded as two"
    by_id = dict(zip(ids, contents, strict=True))
    return {each: by_id[each.source_id] for each in streams}


def _recording(pc: str, content: Mapping[str, Any]) -> Recording:
    stamps = unix_s(pc, np.asarray(content["time_stamps"], np.float64))
    channels = int(content["info"]["channel_count"][0])
    rows = np.asarray(content["time_series"], np.float32).reshape(len(stamps), channels)
    return Recording(stamps, stamps, rows)
