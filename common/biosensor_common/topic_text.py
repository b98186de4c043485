"""Encodes and decodes topics of text: one string a sample, and an agent's counters."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any, Protocol

_CLOCK = "clock_"
CLOCK_FACTS = ("offset_s", "drift_ppm", "residual_rms_s", "reanchors")
"""What an agent tells of a device's clock: see `biosensor_common.device_clock.ClockState`."""


class Sample(Protocol):
    """Values of one sample, one a channel: a tuple, a list or an array."""

    def __len__(self) -> int: ...
    def __getitem__(self, channel: int, /) -> str | float: ...
    def __iter__(self) -> Iterator[Any]: ...


def text_of(sample: Sample) -> str:
    """Return a sample of text as one string; several are a JSON list."""
    # JSON keeps them apart whatever they contain.
    return str(sample[0]) if len(sample) == 1 else json.dumps(list(sample))


def read_counters(text: str) -> dict[str, dict[str, float]]:
    """Read one sample of the agent's counters stream: counters by source_id.

    The entry of one stream of a device has the state of the device's clock as well, under
    ``clock_`` and the names of `CLOCK_FACTS`.

    Raises
    ------
    ValueError
        If it is not what an agent writes.
    """
    try:
        return {str(source_id): _numbers(entry) for source_id, entry in json.loads(text).items()}
    except (AttributeError, KeyError, OverflowError, RecursionError, TypeError) as error:
        raise ValueError("not the counters of an agent") from error


def clock_of(counters: Mapping[str, float]) -> dict[str, float]:
    """Return the state of a device's clock by `CLOCK_FACTS`, of one entry of the counters."""
    told = ((key, counters.get(f"{_CLOCK}{key}")) for key in CLOCK_FACTS)
    return {key: value for key, value in told if value is not None}


def _numbers(entry: Any) -> dict[str, float]:  # noqa: ANN401 - whatever JSON holds
    counters = {key: _finite(entry[key]) for key in ("pushed", "lost", "last_stamp")}
    clock = entry.get("clock", {})
    return counters | {f"{_CLOCK}{key}": _finite(clock[key]) for key in CLOCK_FACTS if key in clock}


def _finite(number: Any) -> float:  # noqa: ANN401 - whatever JSON holds
    value = float(number)
    if not math.isfinite(value):
        raise ValueError(f"{number} is no counter")
    return value
