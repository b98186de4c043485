"""Signals of any kind, rate and unit, from which live features are computed.

A header is refused with a sentence, or nothing raises whatever comes; values are finite but where
a beat or a window has none; qualities are from 0 to 1; each feature's stamps ascend and lie within
those that came; the same comes for any cutting.
"""

from __future__ import annotations

import math
import struct

import numpy as np
from numpy.typing import NDArray

from biosensor_common.lsl.header import MAX_RATE_HZ
from biosensor_common.quantities import ChannelFormat
from biosensor_common.stream_header import CoreFields, foreign_header
from biosensor_gateway.features.outputs import TYPES
from biosensor_gateway.features.runs import Event
from biosensor_gateway.features.sources import FeatureError, Source, judge
from tests.fuzz.contract import ensure

_HEAD = struct.Struct("<BBf")
_PART = struct.Struct("<BBe")
_UNITS = ("mV", "uS", "s", "ms", "g", "", "kohm")
_MOST_SAMPLES = 3000
_MAY_LACK = ("beats", "hrv_live")
_MAY_LACK_ALL = ("hrv_live", "hr_state", "br_state")
_QUALITY = "hr_live_quality"

Array = NDArray[np.float64]


def check(data: bytes) -> None:
    """Take the head for a header, and each part behind it for a piece of a signal."""
    if len(data) < _HEAD.size:
        return
    kind, unit, rate = _HEAD.unpack_from(data)
    source = _source(kind, unit, rate)
    if source is None:
        return
    stamps, values = _signal(data[_HEAD.size :], source)
    whole = _events(source, stamps, values, _MOST_SAMPLES)
    for length in (1 if len(stamps) < 400 else 37, 101):
        ensure(_events(source, stamps, values, length) == whole, "it depends on the cutting")


def _source(kind: int, unit: int, rate: float) -> Source | None:
    content_type, said = TYPES[kind % len(TYPES)].value, _UNITS[unit % len(_UNITS)]
    if not 0 <= rate <= MAX_RATE_HZ:
        # No such stream is taken from the network, or out of a file.
        return None
    core = CoreFields("any", content_type, "id", "host", 3, rate, ChannelFormat.FLOAT32)
    try:
        return judge("any", "id", foreign_header(core, ("x",) * 3, (said,) * 3))
    except FeatureError as error:
        ensure("'any'" in str(error) and "\n" not in str(error), "it is no sentence", str(error))
        return None


def _signal(data: bytes, source: Source) -> tuple[Array, Array]:
    """Each part is so many samples of a shape of a size, from where the one before it ended."""
    rate = source.header.rate if 1 <= source.header.rate <= 2000 else 10.0
    periods: list[Array] = []
    values: list[Array] = []
    level, count = 0.0, 0
    for shape, length, size in _PART.iter_unpack(data[: len(data) // _PART.size * _PART.size]):
        # Up to a quarter of a minute at any rate.
        samples = min(1 + round(length * rate / 16), _MOST_SAMPLES - count)
        if samples <= 0:
            break
        steps = np.full(samples, 1 / rate)
        # More than a gap, backwards, or none at all.
        steps[0] = (1 / rate, 1 / rate, 1 / rate, 3.0, -1.0, math.nan)[shape // 8 % 6]
        periods.append(steps)
        values.append(_shape(shape % 8, size, samples, rate) + level)
        last = float(values[-1][-1])
        level, count = last if abs(last) < 1e9 else 0.0, count + samples
    if not values:
        return np.empty(0), np.empty((0, 3))
    stamps = 100 + np.cumsum(np.nan_to_num(np.concatenate(periods)))
    stamps[np.isnan(np.concatenate(periods))] = math.nan
    return stamps, np.repeat(np.concatenate(values)[:, np.newaxis], 3, axis=1)


def _shape(shape: int, size: float, samples: int, rate: float) -> Array:
    seconds = np.arange(samples) / rate
    if shape == 0 or not math.isfinite(size):
        return np.full(samples, size)
    shapes = (
        lambda: seconds,
        lambda: np.sin(2 * np.pi * seconds),
        lambda: np.sin(2 * np.pi * 0.25 * seconds),
        lambda: np.exp(-0.5 * ((seconds % 0.8 - 0.4) / 0.02) ** 2),
        lambda: np.random.default_rng(samples).standard_normal(samples),
        lambda: np.full(samples, 1e300),
        lambda: np.full(samples, 1e-300),
    )
    return size * shapes[shape - 1]()


def _events(
    source: Source, stamps: Array, values: Array, length: int
) -> list[tuple[str, str, list[str]]]:
    computer = source.new_computer()
    events: list[Event] = []
    for begin in range(0, len(stamps), length):
        events += computer.take(stamps[begin : begin + length], values[begin : begin + length])
    _judge(events, source, stamps)
    told = [(each.feature, each.stamp.hex(), [v.hex() for v in each.values]) for each in events]
    # Between features there is no order.
    return sorted(told, key=lambda each: each[0])


def _judge(events: list[Event], source: Source, stamps: Array) -> None:
    channels = {each.name: len(each.stream.channels) for each in source.features}
    last: dict[str, float] = {}
    for feature, stamp, values in events:
        ensure(len(values) == channels[feature], "other channels", feature, values)
        is_inside = float(np.nanmin(stamps)) - 1 <= stamp <= float(np.nanmax(stamps))
        ensure(is_inside, "no time of it", feature, stamp)
        ensure(stamp > last.get(feature, -math.inf), "stamps do not ascend", feature, stamp)
        last[feature] = stamp
        numbers = values[1:] if feature in _MAY_LACK else values
        if feature in ("sqi", _QUALITY):
            # Of motion nothing is known, and of quality nothing before its window is full.
            numbers = values[: 3 if feature == _QUALITY else -1]
        is_finite = feature in _MAY_LACK_ALL or all(map(math.isfinite, numbers))
        ensure(is_finite and not any(map(math.isinf, values)), "no number", feature, values)
        ensure(feature != "sqi" or _in_unit(values[:-1]), "no quality", feature, values)


def _in_unit(values: tuple[float, ...]) -> bool:
    return all(0 <= each <= 1 for each in values)
