"""Adds timestamps to the data of a board's presets, and emits them."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from biosensor_common.device_clock import DeviceClock
from biosensor_common.errors import ProtocolError, ProtocolReason
from biosensor_gateway.devices.brainflow import BoardStream, Description

if TYPE_CHECKING:
    from biosensor_gateway.streaming.sink import DeviceSink

_HEAD = struct.Struct("<cBI")
_SAMPLES = struct.Struct("<dI")
# More than BrainFlow buffers for any board.
_MOST_BYTES = 1 << 28


@dataclass(frozen=True, slots=True)
class Rows:
    """New data of a preset."""

    preset: int
    # Unix time when they were sent, in seconds; BrainFlow's own timestamps have the same clock.
    now_s: float
    values: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Told:
    """A message of the process; empty for a keep-alive."""

    what: dict[str, Any]


class Frames:
    """Decodes the process's frames from bytes in any pieces."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def feed(self, data: bytes) -> Iterator[Rows | Told]:
        """Add bytes; yield the frames that are complete now.

        Raises
        ------
        ProtocolError
            ``GARBAGE`` if it is not a frame, so later data cannot be parsed either.
        """
        self._waiting += data
        while len(self._waiting) >= _HEAD.size:
            kind, preset, length = _HEAD.unpack_from(self._waiting)
            if kind not in b"JSB" or length > _MOST_BYTES:
                raise _garbage()
            end = _HEAD.size + length
            if len(self._waiting) < end:
                return  # nothing is dropped: the rest of the frame is still to come
            content = bytes(self._waiting[_HEAD.size : end])
            del self._waiting[:end]
            yield _read(kind, preset, content)


def _read(kind: bytes, preset: int, content: bytes) -> Rows | Told:
    try:
        if kind == b"B":
            return Told({})
        if kind == b"J":
            return Told(dict(json.loads(content)))
        now_s, count = _SAMPLES.unpack_from(content)
        values = np.frombuffer(content, "<f8", offset=_SAMPLES.size)
        return Rows(preset, now_s, values.reshape(count, -1))
    except (ValueError, TypeError, struct.error) as error:
        raise _garbage() from error


def _garbage() -> ProtocolError:
    message = "the process that reads the board sent something that is not a frame; it is restarted"
    return ProtocolError(ProtocolReason.GARBAGE, message)


# BrainFlow is polled 50 times a second; an older timestamp means that the clock was set.
_OLDEST_S = 10.0
_WATCHED_S = 10.0
_RATE_ERROR = 0.05

# BrainFlow's timestamps are the computer's time at arrival, so the board's clock is its sample
# count divided by its rate.
COUNTS_UP_TO = MappingProxyType(
    {
        ("SYNTHETIC_BOARD", 0): 256,
        ("SYNTHETIC_BOARD", 1): 256,
        ("CYTON_BOARD", 0): 256,
        ("GANGLION_BOARD", 0): 201,
    }
)
"""Where a board's packet number overflows, for presets in which it counts samples.

In all others it counts something else, or BrainFlow itself counts, so losses are unknown.
"""


class SampleCount:
    """Unwraps the packet number of one preset; `turns_over_at` is 0 if it is unusable."""

    def __init__(self, turns_over_at: int) -> None:
        self._turn = turns_over_at
        self._number: float | None = None
        self._count = -1

    def place(self, numbers: NDArray[np.float64]) -> tuple[NDArray[np.int64], int]:
        """Return the number of each sample since the start, and how many are missing."""
        if not self._turn:
            steps = np.ones(len(numbers), np.int64)
        else:
            first = numbers[0] - 1 if self._number is None else self._number
            differences = np.diff(numbers, prepend=first)
            # A repeated number still belongs to a new sample.
            steps = np.maximum(1, np.round(differences % self._turn)).astype(np.int64)
            self._number = float(numbers[-1])
        places = self._count + np.cumsum(steps)
        self._count = int(places[-1])
        return places, int(steps.sum()) - len(steps)


class OwnClock:
    """The clock of a further preset of the board, which has a separate rate."""

    def __init__(self, sink: DeviceSink) -> None:
        self._sink, self._clock = sink, DeviceClock()

    def observe(self, device_s: float, arrival_s: float) -> None:
        """See :meth:`DeviceSink.observe`."""
        self._clock.observe(device_s, arrival_s)

    def emit(self, data_name: str, samples: NDArray[np.float64], times: Sequence[float]) -> None:
        """See :meth:`DeviceSink.emit`."""
        self._sink.emit_at(data_name, samples, self._clock.all_to_lsl(times))


class PresetEmitter:
    """Emits the data of one preset for one connection.

    Parameters
    ----------
    description
        Contains the rows of its packet number and timestamp.
    turns_over_at
        Overflow of its packet number; see `SampleCount`.
    stamps
        The sink itself for the first preset, so that its clock is the device's.
    """

    def __init__(
        self,
        streams: Sequence[BoardStream],
        description: Description,
        rate_hz: float,
        turns_over_at: int,
        sink: DeviceSink,
        stamps: DeviceSink | OwnClock,
    ) -> None:
        self._streams, self._rate_hz = streams, rate_hz
        self._stamp_row: int = description["timestamp_channel"]
        self._number_row: int = description["package_num_channel"]
        self._rows: int = description["num_rows"]
        self._count = SampleCount(turns_over_at)
        self._sink, self._stamps = sink, stamps
        self._states: dict[str, tuple[float, ...]] = {}
        self._begin: tuple[float, int] | None = None
        self._remark = ""

    def take(self, rows: Rows, arrival_s: float) -> None:
        """Emit rows received together; *arrival_s* is the LSL time when they were sent."""
        values = rows.values
        if not values.shape[1]:
            return  # nothing is dropped: there is nothing
        if values.shape[0] != self._rows:
            self._sink.dropped_bytes += values.nbytes
            return
        places, lost = self._count.place(values[self._number_row])
        age_s = rows.now_s - float(values[self._stamp_row, -1])
        measured_s = arrival_s - age_s if 0 <= age_s < _OLDEST_S else arrival_s
        times = (places / self._rate_hz).tolist()
        self._stamps.observe(times[-1], measured_s)
        self._sink.heard()
        for stream in self._streams:
            samples = values[list(stream.rows)].T
            if stream.is_state:
                self._emit_changes(stream, samples, times)
                continue  # nothing is dropped: its changes are sent
            if lost:
                self._sink.lost(stream.spec.data_name, lost)
            self._stamps.emit(stream.spec.data_name, samples, times)
        self._watch_rate(measured_s, int(places[-1]))

    def _emit_changes(
        self, stream: BoardStream, samples: NDArray[np.float64], times: Sequence[float]
    ) -> None:
        name = stream.spec.data_name
        for sample, time_s in zip(samples, times, strict=True):
            value = tuple(sample.tolist())
            if value != self._states.get(name):
                self._states[name] = value
                self._stamps.emit(name, sample[np.newaxis], [time_s])

    def _watch_rate(self, measured_s: float, place: int) -> None:
        """Say if a board's rate differs from the declared one."""
        if self._begin is None:
            self._begin = measured_s, place
        elapsed_s = measured_s - self._begin[0]
        if elapsed_s < _WATCHED_S:
            return  # nothing is dropped: the rate is watched for longer
        rate = (place - self._begin[1]) / elapsed_s
        self._begin = measured_s, place
        text = ""
        if abs(rate / self._rate_hz - 1) > _RATE_ERROR:
            text = (
                f"the board sends {rate:.1f} samples per second but {self._rate_hz:g} are "
                "declared, so its timestamps are wrong; set rate_hz"
            )
        if text != self._remark:
            self._remark = text
            self._sink.remark(f"rate of {[each.spec.data_name for each in self._streams]}", text)
