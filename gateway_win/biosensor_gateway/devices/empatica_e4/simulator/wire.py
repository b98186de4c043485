"""The samples that travel from a wristband to the server."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import nan
from typing import NamedTuple

from biosensor_gateway.devices.empatica_e4.simulator.number_format import NumberFormat

COUNTS_PER_G = 64


class Stream(NamedTuple):
    """One stream of the wire.

    Attributes
    ----------
    word
        That begins its lines.
    subscription
        Word that clients subscribe to.
    data_name
        Of the declaration.
    rate_hz
        By which the server numbers its samples; None for what comes with its own time.
    declared
        Makes values of the declaration from those of the wire.
    """

    word: str
    subscription: str
    data_name: str
    rate_hz: float | None
    declared: Callable[[Sequence[float]], tuple[float, ...]]


def _conductance(values: Sequence[float]) -> tuple[float, ...]:
    return (nan if values[0] == 0 else values[0],)


def _acceleration(values: Sequence[float]) -> tuple[float, ...]:
    return tuple(value / COUNTS_PER_G for value in values)


def _charge(values: Sequence[float]) -> tuple[float, ...]:
    return (values[0] * 100,)


BVP = Stream("E4_Bvp", "bvp", "bvp", 63.997, tuple)
ACC = Stream("E4_Acc", "acc", "acc", 32, _acceleration)
GSR = Stream("E4_Gsr", "gsr", "gsr", 4, _conductance)
TEMPERATURE = Stream("E4_Temperature", "tmp", "st", 4, tuple)
HR = Stream("E4_Hr", "ibi", "hr", None, tuple)
IBI = Stream("E4_Ibi", "ibi", "ibi", None, tuple)
BATTERY = Stream("E4_Battery", "bat", "bat", None, _charge)
TAG = Stream("E4_Tag", "tag", "tag", None, tuple)
SUBSCRIPTIONS = frozenset({"acc", "bvp", "gsr", "ibi", "tmp", "bat", "tag"})


class Sample(NamedTuple):
    """One sample.

    Attributes
    ----------
    measured_s
        True time [s, LSL clock].
    after_s
        Seconds of the wristband's crystal since its radio link began.
    values
        Of the wire, as exact as it can say them.
    """

    stream: Stream
    measured_s: float
    after_s: float
    values: tuple[float, ...]

    @property
    def declared_values(self) -> tuple[float, ...]:
        """Values in the units of the declaration."""
        return self.stream.declared(self.values)

    def line(self, stamp_s: float, style: NumberFormat) -> bytes:
        """Write the sample's line, with its end."""
        numbers = (style.value(value) for value in self.values)
        return (" ".join((self.stream.word, style.stamp(stamp_s), *numbers)) + "\r\n").encode()


@dataclass(frozen=True, slots=True, order=True)
class Packet:
    """Samples that travel together, ordered by when they arrive at the server.

    Attributes
    ----------
    arrives_s
        On the LSL clock.
    number
        Decides between packets that arrive together.
    samples
        All of one subscription, in the order of their lines.
    """

    arrives_s: float
    number: int
    samples: tuple[Sample, ...] = field(compare=False)

    @property
    def subscription(self) -> str:
        """Word that clients subscribe to."""
        return self.samples[0].stream.subscription
