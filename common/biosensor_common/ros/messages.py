"""Serialises samples, texts and an agent's counters as raw, chunk and stamped messages."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from biosensor_common.quantities import ChannelFormat, MessageType
from biosensor_common.ros.cdr import ENCAPSULATION, aligned, cut, stamp, text, texts
from biosensor_common.stream_header import StreamHeader

# Chunk lengths may change at any time, so the heads of the recent ones are cached.
_CHUNK_SHAPES = 256
# From this number of samples on, building rows of one array is faster.
_MANY = 100
_DTYPES: dict[MessageType, np.dtype[Any]] = {
    MessageType.FLOAT32: np.dtype("<f4"),
    MessageType.FLOAT32_MULTI_ARRAY: np.dtype("<f4"),
    MessageType.FLOAT64_MULTI_ARRAY: np.dtype("<f8"),
    MessageType.INT32_MULTI_ARRAY: np.dtype("<i4"),
    MessageType.INT64_MULTI_ARRAY: np.dtype("<i8"),
    MessageType.UINT8: np.dtype("<u1"),
    MessageType.UINT16: np.dtype("<u2"),
}
_COUNT, _SIZE_AND_STRIDE = struct.Struct("<I"), struct.Struct("<II")
_DATA_OFFSET = 0
_COUNTS = struct.Struct("<Qq?")
UNKNOWN_LOSS = -1
"""Count of lost samples in a recording: losses before the recorder are unknown."""
_NO_VALUES = bytes(4)


def wire_dtype(message_type: MessageType) -> np.dtype[Any]:
    """Return the numpy type of a message's values.

    Raises
    ------
    KeyError
        If the message has no numbers.
    """
    return _DTYPES[message_type]


def to_bytes(samples: NDArray[Any], dtype: np.dtype[Any]) -> bytes:
    """Convert samples to another type; a float that is too large becomes infinite."""
    if samples.dtype == dtype:
        return samples.tobytes()
    with np.errstate(over="ignore"):
        return samples.astype(dtype).tobytes()


class RawNumbers:
    """One message per sample, without a stamp.

    Parameters
    ----------
    channels
        Values per sample; 1 for a message that is not an array.
    """

    def __init__(self, message_type: MessageType, channels: int) -> None:
        self._dtype = _DTYPES[message_type]
        self._size = channels * self._dtype.itemsize
        self._limits = message_type.integer_range
        self._head, self._tail = ENCAPSULATION, b""
        if message_type.is_array:
            self._head = _array_head(self._dtype, channels, channels=channels)
        else:
            # ROS pads messages of a fixed size to an aligned end.
            self._tail = bytes(-self._size % 4)

    def fitting(self, values: NDArray[Any]) -> NDArray[np.bool_] | None:
        """Return for each sample whether the message can hold it; None if it can hold all.

        Parameters
        ----------
        values : ndarray, shape (n, n_channels)
        """
        if self._limits is None:
            return None
        low, high = self._limits
        fits = np.asarray(((values >= low) & (values <= high)).all(axis=1), np.bool_)
        return None if fits.all() else fits

    def encode(self, values: NDArray[Any]) -> list[bytes]:
        """Serialise samples that fit, of shape (n, n_channels)."""
        head, tail, size = self._head, self._tail, self._size
        wire = to_bytes(values, self._dtype)
        # A live stream usually brings one or a few samples at once, a recording thousands.
        if len(wire) == size:
            return [head + wire + tail]
        if len(values) < _MANY:
            return [head + wire[at : at + size] + tail for at in range(0, len(wire), size)]
        begin, end = len(head), len(head) + size
        rows = np.zeros((len(values), end + len(tail)), np.uint8)
        rows[:, :begin] = np.frombuffer(head, np.uint8)
        rows[:, begin:end] = np.frombuffer(wire, np.uint8).reshape(len(values), size)
        return cut(rows.tobytes(), rows.shape[1])


def chunk_message(message_type: MessageType, values: bytes, channels: int) -> bytes:
    """Serialise a chunk in row-major order; ``layout.dim`` = [samples, channels]."""
    return _chunk_head(message_type, len(values), channels) + values


@lru_cache(_CHUNK_SHAPES)
def _chunk_head(message_type: MessageType, size: int, channels: int) -> bytes:
    dtype = _DTYPES[message_type]
    count = size // dtype.itemsize
    return _array_head(dtype, count, samples=count // channels, channels=channels)


def _array_head(dtype: np.dtype[Any], count: int, **sizes: int) -> bytes:
    """Return the bytes of an array message before its *count* values.

    Parameters
    ----------
    **sizes
        Sizes of the dimensions by label; a stride covers all following dimensions.
    """
    content, stride = _COUNT.pack(len(sizes)), count
    for label, size in sizes.items():
        content = aligned(content + text(label), 4) + _SIZE_AND_STRIDE.pack(size, stride)
        stride //= size
    content += _COUNT.pack(_DATA_OFFSET) + _COUNT.pack(count)
    return ENCAPSULATION + aligned(content, dtype.itemsize)


class StampedNumbers:
    """``biosensor_msgs/Samples``: one message for samples that came together."""

    def __init__(self, header: StreamHeader, frame_id: str) -> None:
        self._is_int64 = header.format is ChannelFormat.INT64
        self._frame = aligned(text(frame_id), 8)
        names = aligned(texts(header.labels), 4) + texts(header.units)
        # A flag of one byte precedes the names, which therefore need padding.
        self._names = bytes(3) + aligned(names, 4)

    def encode(
        self,
        unix_ns: NDArray[np.int64],
        values: NDArray[Any],
        sequence: int,
        lost: int = UNKNOWN_LOSS,
        *,
        lost_is_estimated: bool = False,
    ) -> bytes:
        """Serialise samples as one message.

        Parameters
        ----------
        unix_ns : ndarray of int64, shape (n,)
        values : ndarray, shape (n, n_channels)
        sequence
            Number of the first sample.
        lost
            Samples of the stream lost so far.
        """
        offsets = (unix_ns - unix_ns[0]).tobytes()
        content = self._frame + _COUNTS.pack(sequence, lost, lost_is_estimated) + self._names
        content = _with_values(content, len(unix_ns), offsets)
        dtype = "<i8" if self._is_int64 else "<f8"
        wire = values.astype(dtype).tobytes()
        if self._is_int64:
            content = _with_values(content + _NO_VALUES, values.size, wire)
        else:
            content = _with_values(content, values.size, wire) + _NO_VALUES
        return ENCAPSULATION + stamp(int(unix_ns[0])) + content


def _with_values(content: bytes, count: int, values: bytes) -> bytes:
    """Append a sequence of values of 8 bytes each."""
    return aligned(content + count.to_bytes(4, "little"), 8) + values


_CLOCK = "clock_"
CLOCK_FACTS = ("offset_s", "drift_ppm", "residual_rms_s", "reanchors")
"""Facts of a device's clock in an agent's counters, see `.device_clock.ClockState`."""


def text_of(sample: Sequence[Any] | NDArray[Any]) -> str:
    """Return a text sample as one string; several channels become a JSON list."""
    # JSON separates them, whatever characters they contain.
    return str(sample[0]) if len(sample) == 1 else json.dumps(list(sample))


def read_counters(text: str) -> dict[str, dict[str, float]]:
    """Parse one sample of the agent's counters stream: counters by source_id.

    One stream's entry per device also has the state of the device's clock, as ``clock_``
    followed by a name of `CLOCK_FACTS`.

    Raises
    ------
    ValueError
        If it is not in an agent's format.
    """
    try:
        return {str(source_id): _numbers(entry) for source_id, entry in json.loads(text).items()}
    except (AttributeError, KeyError, OverflowError, RecursionError, TypeError) as error:
        raise ValueError("not the counters of an agent") from error


class AgentSays(NamedTuple):
    """Facts that an agent reports about a stream, besides its counters.

    Attributes
    ----------
    away
        State of the stream's device while that does not send; else empty.
    refused
        Data not passed on unchanged, one sentence each.
    of_device
        The same of no single stream of its device, in the entry of one of its streams.
    """

    away: str = ""
    refused: tuple[str, ...] = ()
    of_device: tuple[str, ...] = ()


def said_of_streams(text: str) -> dict[str, AgentSays]:
    """Return the contents of one sample of the agent's counters stream, by source_id.

    Raises
    ------
    ValueError
        If it is not in an agent's format.
    """
    try:
        return {str(source): _says(entry) for source, entry in json.loads(text).items()}
    except (AttributeError, RecursionError) as error:
        raise ValueError("not the counters of an agent") from error


def _says(entry: Any) -> AgentSays:  # noqa: ANN401 - whatever JSON holds
    away = entry.get("away")
    return AgentSays(
        away if isinstance(away, str) else "",
        _sentences(entry.get("refused")),
        _sentences(entry.get("of_device")),
    )


def _sentences(told: object) -> tuple[str, ...]:
    return tuple(map(str, cast("list[object]", told))) if isinstance(told, list) else ()


def clock_of(counters: Mapping[str, float]) -> dict[str, float]:
    """Return the state of a device's clock, by `CLOCK_FACTS`, from one entry of the counters."""
    told = ((key, counters.get(f"{_CLOCK}{key}")) for key in CLOCK_FACTS)
    return {key: value for key, value in told if value is not None}


def _numbers(entry: Any) -> dict[str, float]:  # noqa: ANN401 - whatever JSON holds
    counters = {key: _finite(entry[key]) for key in ("pushed", "lost", "last_stamp")}
    clock = entry.get("clock", {})
    return counters | {f"{_CLOCK}{key}": _finite(clock[key]) for key in CLOCK_FACTS if key in clock}


def _finite(number: Any) -> float:  # noqa: ANN401 - whatever JSON holds
    value = float(number)
    if not math.isfinite(value):
        raise ValueError(f"{number} is not a counter")
    return value


_SEQUENCE = struct.Struct("<Q")
# A message without fields still has one byte, padded to an aligned end.
_EMPTY = ENCAPSULATION + bytes(4)
_OK = b"\0"
_NO_TEXT = text("")


def raw_text(message_type: MessageType, value: str) -> bytes:
    """Serialise a ``std_msgs/String``, or an ``Empty`` without the text."""
    return _EMPTY if message_type is MessageType.EMPTY else ENCAPSULATION + text(value)


class StampedTexts:
    """``biosensor_msgs/Event``: one message per sample."""

    def __init__(self, frame_id: str) -> None:
        self._frame = aligned(text(frame_id), 8)

    def encode(self, unix_ns: int, value: str, sequence: int) -> bytes:
        """Serialise one sample."""
        head = ENCAPSULATION + stamp(unix_ns) + self._frame
        return head + _SEQUENCE.pack(sequence) + text(value)


def counters_message(unix_ns: int, value: str) -> bytes:
    """Serialise one sample of the agent's counters as ``diagnostic_msgs/DiagnosticArray``.

    Raises
    ------
    ValueError
        If it is not in an agent's format.
    """
    content = bytearray(aligned(stamp(unix_ns) + _NO_TEXT, 4))
    counters = read_counters(value)
    content += len(counters).to_bytes(4, "little")
    for source_id, values in counters.items():
        content += _OK
        for part in (source_id, "", ""):
            _append(content, text(part))
        _append(content, len(values).to_bytes(4, "little"))
        for key, number in values.items():
            _append(content, text(key))
            _append(content, text(str(number)))
    return ENCAPSULATION + bytes(content)


def _append(content: bytearray, part: bytes) -> None:
    content += bytes(-len(content) % 4)
    content += part
