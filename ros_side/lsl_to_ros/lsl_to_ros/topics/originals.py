"""Topics as ros2-foxy-wearable-biosensors publishes them, for clients that were written for it.

Where its code and its description differ, the code counts, because its clients were used with it.
The parameter ``compat`` switches this on; the stamped topics, which the original does not have,
stay unchanged. The original is a finished program of others, so its sensors are named here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import Int32

from biosensor_common.lsl.inlet import Block
from biosensor_common.quantities import MessageType
from biosensor_common.refusal import Refusal, Refusals
from lsl_to_ros.topics.publishers import TopicPublisher
from lsl_to_ros.topics.writers import NumberWriter, Run, Writer

_TICKS_PER_S = 1024
_UNITS_PER_G = 64
_KOHM_MICROSIEMENS = 1000.0
# Two streams are pushed together, and sent and read apart.
_MOST_HELD = 256
_TOLERANCE_S = 0.002

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Original:
    """One topic of the original that is made from a stream."""

    data: str  # Last part of the topic's name.
    # Converts the stream's values, shape (n, channels), to the topic's, shape (n, columns).
    values: Callable[[Values], Values]
    columns: int = 1
    is_int32: bool = False  # Whether its messages are `Int32`; else they have the stream's type.
    # Data name of another stream of the device, whose channels are appended to this one's.
    beside: str = ""
    beside_channels: int = 0
    without: str = ""  # Columns that are missing without data of that stream.


def _ticks(seconds: Values) -> Values:
    return np.rint(seconds * _TICKS_PER_S)


def _low_byte(seconds: Values) -> Values:
    return _ticks(seconds) % 256


def _high_byte(seconds: Values) -> Values:
    return _ticks(seconds) // 256


def _or(default: float) -> Callable[[Values], Values]:
    return lambda values: np.where(np.isnan(values), default, values)


def _with_status(values: Values) -> Values:
    """Return counter, interpolated, five electrodes and contact quality."""
    eeg, counter, quality = values[:, :5], values[:, 5:7], values[:, 7:8]
    return np.hstack((counter, eeg, quality))


ORIGINALS: Mapping[tuple[str, str], tuple[Original, ...]] = MappingProxyType(
    {
        ("polar_h10", "hr"): (Original("hr", np.rint, is_int32=True),),
        # The original reads the two bytes of an interval as an interval and a battery.
        ("polar_h10", "ibi"): (
            Original("ibi", _low_byte, is_int32=True),
            Original("dev", _high_byte, is_int32=True),
        ),
        ("empatica_e4", "acc"): (Original("acc", lambda g: g * _UNITS_PER_G, columns=3),),
        ("empatica_e4", "bat"): (Original("bat", lambda percent: percent / 100),),
        ("empatica_e4", "gsr"): (Original("gsr", _or(0.0)),),
        ("shimmer3_gsr", "gsr"): (Original("gsr", lambda us: _KOHM_MICROSIEMENS / us),),
        ("emotiv_insight", "eeg"): (
            Original(
                "eeg",
                _with_status,
                columns=8,
                beside="eeg_status",
                beside_channels=4,
                without="counter and contact quality",
            ),
        ),
        ("emotiv_insight", "met"): (Original("met", lambda all_8: _or(0.0)(all_8[:, :7]), 7),),
        ("emotiv_insight", "dev"): (Original("dev", _or(-1.0), columns=9),),
    }
)
"""Topics by the stream's sensor and data name; the first of each replaces the stream's own one."""
BESIDE: Mapping[tuple[str, str], str] = MappingProxyType(
    {
        (sensor, first.beside): data
        for (sensor, data), (first, *_) in ORIGINALS.items()
        if first.beside
    }
)
"""By a stream's sensor and data name: the stream to which it belongs in the original."""


class Shape(Protocol):
    """Converts a stream's samples to those of its topics."""

    def __call__(self, run: Run) -> Run:
        """Return the samples that are complete."""
        ...


class Alone:
    """The shape of a topic made from one stream."""

    def __init__(self, original: Original) -> None:
        self._values = original.values

    def __call__(self, run: Run) -> Run:
        """Return all samples with the original's values."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return run._replace(samples=self._values(run.samples.astype(np.float64)))


class _Row(NamedTuple):
    stamp: float
    values: NDArray[Any]


class Joined:
    """The shape of a topic made from two streams, sample by sample.

    Samples wait until the other stream's part has arrived.
    """

    def __init__(self, original: Original) -> None:
        self._original = original
        self._held: deque[tuple[_Row, int]] = deque()
        # nothing is dropped: it is read only while the other stream is there
        self._others: deque[_Row] = deque(maxlen=4 * _MOST_HELD)
        # Get reports of samples that were published without the other part.
        self.refusals: Refusals | None = None
        # Called by :meth:`take`, in the thread that reads the other stream.
        self.more: Callable[[], None] | None = None

    def take(self, block: Block) -> None:
        """Add samples of the other stream."""
        self._others.extend(map(_Row, block.stamps.tolist(), block.samples.copy()))
        if self.more is not None:
            self.more()

    def __call__(self, run: Run) -> Run:
        """Return samples, including earlier ones, that are complete or have waited too long."""
        numbers = range(run.sequence, run.sequence + len(run.stamps))
        self._held.extend(
            zip(map(_Row, run.stamps.tolist(), run.samples.copy()), numbers, strict=True)
        )
        rows: list[tuple[_Row, int]] = []
        missing = 0
        while self._held:
            row, number = self._held[0]
            other = self._other(row.stamp)
            if other is None and not self._others and len(self._held) <= _MOST_HELD:
                break
            if other is None:
                missing += 1
                other = np.full(self._original.beside_channels, np.nan)
            rows.append((_Row(row.stamp, np.concatenate((row.values, other))), number))
            self._held.popleft()
        if missing and self.refusals is not None:
            facts = {"columns": self._original.without, "stream": self._original.beside}
            self.refusals.refuse(Refusal.NOT_JOINED, missing, **facts)
        return self._run(rows)

    def _other(self, stamp: float) -> NDArray[Any] | None:
        """Return the sample of the other stream with the same time; None if there is none."""
        while self._others and self._others[0].stamp < stamp - _TOLERANCE_S:
            # nothing is dropped: it is on a topic of its own
            self._others.popleft()
        if self._others and self._others[0].stamp <= stamp + _TOLERANCE_S:
            return self._others.popleft().values
        return None  # nothing is dropped: it is not there

    def _run(self, rows: list[tuple[_Row, int]]) -> Run:
        if not rows:
            return Run(np.empty((0, self._original.columns)), np.empty(0), 0)
        samples = self._original.values(np.array([row.values for row, _ in rows], np.float64))
        return Run(samples, np.array([row.stamp for row, _ in rows]), rows[0][1])


class Int32Writer(Writer):
    """One ``Int32`` per sample."""

    def write(self, run: Run) -> None:
        """Publish each sample; raise ValueError for NaN."""
        self.publisher.publish(*(Int32(data=int(value)) for (value,) in run.samples.tolist()))


class FurtherWriter(Int32Writer):
    """Another topic that the original makes from a stream."""

    def __init__(self, publisher: TopicPublisher, original: Original) -> None:
        super().__init__(publisher)
        self._shape = Alone(original)

    def write(self, run: Run) -> None:
        """Publish each sample."""
        super().write(self._shape(run))


def message_class(original: Original, usual: type[Any]) -> type[Any]:
    """Return the class of the original's messages."""
    return Int32 if original.is_int32 else usual


def writer(
    publisher: TopicPublisher, original: Original, kind: MessageType, refusals: Refusals
) -> Writer:
    """Return a writer for samples that are already converted."""
    if original.is_int32:
        return Int32Writer(publisher)
    return NumberWriter(publisher, kind, original.columns, refusals)
