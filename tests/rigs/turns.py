"""Divides sensors into turns, for tests in which too many devices at a time would be late.

With all programs of a test, seven virtual devices keep one and a half of two processors busy.
Any sensor that comes on top would make the tests tell of the machine instead of the product.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import cycle
from math import ceil

from biosensor_common.spec import FromDevice
from biosensor_gateway.devices.registry import declaration

MOST = 8
OF_A_LAB = (
    "ble_heart_rate",
    "emotiv_insight",
    "empatica_e4",
    "polar_h10",
    "shimmer3_gsr",
    "vernier_respiration_belt",
    "zephyr",
)
"""As many as the requirements name for a lab, whatever else there is a driver for."""
_UNKNOWN_HZ = 50.0


def turns(names: Sequence[str], most: int = MOST) -> tuple[tuple[str, ...], ...]:
    """Divide sensors into as few turns as there can be, all with about as much to do.

    Parameters
    ----------
    names
        Of sensors.
    most
        Devices at a time.

    Returns
    -------
    tuple
        Each sensor once, in its turn; within a turn in the order in which they were given.
    """
    count = ceil(len(names) / most)
    dealt = _there_and_back(count, len(names))
    turn_of = dict(zip(sorted(names, key=_load, reverse=True), dealt, strict=True))
    return tuple(tuple(name for name in names if turn_of[name] == turn) for turn in range(count))


def turn_of(name: str, among: Iterable[tuple[str, ...]]) -> tuple[str, ...]:
    """Return the turn in which a sensor is."""
    return next(turn for turn in among if name in turn)


def _there_and_back(count: int, length: int) -> list[int]:
    """Deal from the first to the last and back, so that nobody always has the larger one."""
    forth = list(range(count))
    ways = cycle((forth, forth[::-1]))
    return [place for way, _ in zip(ways, range(length), strict=False) for place in way][:length]


def _load(name: str) -> tuple[float, int]:
    """Samples a second, as far as the declaration says; then streams."""
    streams = declaration(name).streams
    rates = [_UNKNOWN_HZ if isinstance(each.rate, FromDevice) else each.rate for each in streams]
    return sum(rates), len(streams)
