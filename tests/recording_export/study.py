"""Makes a small recording of what the formats are about."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from biosensor_common.lsl_header import describe
from biosensor_common.naming import lsl_name, source_id
from biosensor_common.spec import DeviceIdentity, DeviceInfo
from biosensor_gateway.devices.registry import declaration
from tests.xdf import xdf_file as made

BEGIN_S = 1000.0
UNIX_NS = 1_790_000_000_250_000_000
"""At that LSL time."""


def ours(
    number: int,
    sensor: str,
    data_name: str,
    values: Sequence[Sequence[Any]] | NDArray[Any],
    stamps: Sequence[float] | NDArray[np.float64],
    participant: str = "P1",
) -> bytes:
    """Header, samples and clock offsets of a declared stream."""
    owner = DeviceIdentity(sensor, "U1", participant)
    stream = declaration(sensor).stream(data_name)
    fmt = stream.format.value
    assert isinstance(stream.rate, float | int)
    header = made.stream_header(
        number,
        lsl_name(owner, data_name),
        kind=stream.content_type.value,
        channels=len(stream.channels),
        rate=float(stream.rate),
        fmt=fmt,
        source_id=source_id(owner, data_name),
        desc=describe(stream, owner, DeviceInfo()),
    )
    rows = values.tolist() if isinstance(values, np.ndarray) else values
    samples = made.samples(number, fmt, rows, [float(each) for each in stamps])
    ends = (float(stamps[0]), float(stamps[-1]))
    return header + samples + made.offsets(number, ends)


def ecg_values(count: int, seed: int = 1) -> NDArray[np.float32]:
    """Something like an ECG in microvolts, shape (count, 1)."""
    noise = np.random.default_rng(seed).normal(0, 300, (count, 1))
    return noise.astype(np.float32)


def study() -> bytes:
    """An ECG of 20 s with a gap of 5 s, intervals, skin conductance, and markers of two people."""
    first = BEGIN_S + np.arange(1300) / 130
    ecg_s = np.concatenate((first, first + 15.0))
    beats_s = BEGIN_S + np.cumsum(np.full(20, 0.8))
    gsr_s = BEGIN_S + np.arange(80) / 4
    conductance = (5 + np.sin(np.arange(80) / 9)).astype(np.float32)[:, np.newaxis]
    conductance[7] = np.nan
    clock = {"clock": {"lsl_s": BEGIN_S, "unix_ns": UNIX_NS}, "event": "heartbeat"}
    return made.xdf(
        ours(1, "polar_h10", "ecg", ecg_values(2600), ecg_s),
        ours(2, "polar_h10", "ibi", [[0.8]] * 19 + [[np.nan]], beats_s),
        ours(3, "empatica_e4", "gsr", conductance, gsr_s, "P2"),
        ours(4, "gateway", "markers", [["go"], ['say "no",\nthen stop']], [1003.0, 1012.0], ""),
        ours(5, "gateway", "events", [[json.dumps(clock)]], [BEGIN_S], ""),
    )
