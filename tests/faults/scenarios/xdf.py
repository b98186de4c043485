"""What LabRecorder wrote, as anybody loads it: by pyxdf with its defaults."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyxdf

from tests.faults.recorder import Recorded

_load_xdf: Callable[..., tuple[list[dict[str, Any]], dict[str, Any]]] = cast("Any", pyxdf).load_xdf


def load(path: Path, *, as_written: bool = False) -> Mapping[str, Recorded]:
    """Return the numeric streams of a file by source_id, which must be one each.

    Clocks are synchronised and jitter is removed, as pyxdf does unless told otherwise. The
    arrival of a sample is not known; its stamp is in that place.

    Parameters
    ----------
    as_written
        Leave the stamps as the agent has sent them.
    """
    options = {"synchronize_clocks": False, "dejitter_timestamps": False} if as_written else {}
    every, _ = _load_xdf(str(path), **options)
    streams = [each for each in every if each["info"]["channel_format"] != ["string"]]
    loaded = {each["info"]["source_id"][0]: _recorded(each) for each in streams}
    assert len(loaded) == len(streams), "a stream was recorded as two"
    return loaded


def _recorded(stream: Mapping[str, Any]) -> Recorded:
    times = np.asarray(stream["time_stamps"], np.float64)
    values = np.asarray(stream["time_series"], np.float64).reshape(len(times), -1)
    return Recorded(times, values, times)
