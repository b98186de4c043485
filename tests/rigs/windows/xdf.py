"""What LabRecorder has recorded of the agent's streams, sample by sample."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pyxdf
from numpy.typing import NDArray

from biosensor_common.quantities import ContentType
from tests.rigs.hosts.counters import canonical

_load_xdf: Callable[..., tuple[list[dict[str, Any]], dict[str, Any]]] = cast("Any", pyxdf).load_xdf


class XdfStream(NamedTuple):
    """One stream.

    Attributes
    ----------
    stamps : ndarray of float64, shape (n,)
        On the sender's LSL clock, as they were sent.
    times : ndarray of float64, shape (n,)
        The same on the LSL clock of LabRecorder's computer, by its measurements.
    rows : ndarray, shape (n, channels)
        Values, as float32 or text.
    corrections : ndarray of float64
        What LabRecorder measured that its LSL clock is ahead of the sender's, in seconds.
    """

    stamps: NDArray[np.float64]
    times: NDArray[np.float64]
    rows: NDArray[Any]
    corrections: NDArray[np.float64]


def read(path: Path) -> dict[str, XdfStream]:
    """Return all streams by source_id."""
    sent, _ = _load_xdf(str(path), synchronize_clocks=False, dejitter_timestamps=False)
    corrected, _ = _load_xdf(str(path), synchronize_clocks=True, dejitter_timestamps=False)
    times = {_source_id(stream): stream["time_stamps"] for stream in corrected}
    return {
        source: XdfStream(
            np.asarray(stream["time_stamps"], np.float64),
            np.asarray(times[source], np.float64),
            _rows(stream),
            np.asarray(stream["clock_values"], np.float64),
        )
        for stream in sent
        for source in (_source_id(stream),)
    }


def _source_id(stream: Mapping[str, Any]) -> str:
    return stream["info"]["source_id"][0]


def _rows(stream: Mapping[str, Any]) -> NDArray[Any]:
    info, samples = stream["info"], stream["time_series"]
    if info["type"] == [ContentType.COUNTERS]:
        samples = [[canonical(json.loads(sample[0]))] for sample in samples]
    kind = np.str_ if info["channel_format"] == ["string"] else np.float32
    return np.array(samples, kind).reshape(len(samples), int(info["channel_count"][0]))
