"""Decodes samples chunks, and the clock offset chunks that belong to them.

A samples chunk has for each sample an optional timestamp and one value per channel.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_common.quantities import ChannelFormat, constant_s
from biosensor_gateway.recording.xdf.container import ChunkError
from biosensor_gateway.recording.xdf.header import RecordedHeader, decoded

_DTYPES: dict[ChannelFormat, np.dtype[Any]] = {
    ChannelFormat.FLOAT32: np.dtype("<f4"),
    ChannelFormat.DOUBLE64: np.dtype("<f8"),
    ChannelFormat.INT64: np.dtype("<i8"),
    ChannelFormat.INT32: np.dtype("<i4"),
    ChannelFormat.INT16: np.dtype("<i2"),
    ChannelFormat.INT8: np.dtype("<i1"),
}
STAMP_BYTES = 8
_CLOCK_OFFSET = struct.Struct("<dd")
_LENGTH_SIZES = frozenset({1, 4, 8})


_FEWEST, _MOST = 64, 10_000
# Channels that other programs have among their signals, and that may rest.
_RESTS = re.compile(r"(?i)tri?g|stim|status|marker|event|count|batt|digital|button|time")

Texts = list[tuple[str, ...]]
"""One tuple per sample, with one text per channel."""


@dataclass(frozen=True, slots=True)
class Block:
    """The samples of one chunk.

    Attributes
    ----------
    stamps : ndarray of float64, shape (n_samples,)
        LSL time on the stream's own clock; where the recorder omitted a timestamp, one period
        after the previous sample.
    values : ndarray, shape (n_samples, n_channels), or list of tuple
        In the stream's own format; may be a view of the chunk. A list in text streams.
    unstamped
        Number of samples before the first one that has its own timestamp.
    guessed
        Number of texts that are not UTF-8, so their encoding was guessed.
    """

    stamps: NDArray[np.float64]
    values: NDArray[Any] | Texts
    unstamped: int = 0
    guessed: int = 0

    @property
    def nan_counts(self) -> NDArray[np.int64] | int:
        """Number of NaN or infinite samples of each channel; 0 in streams of text or integers."""
        if isinstance(self.values, list) or self.values.dtype.kind != "f":
            return 0
        return np.asarray((~np.isfinite(self.values)).sum(axis=0), np.int64)

    @property
    def texts(self) -> tuple[str, ...]:
        """The first channel of a text stream; empty for other streams."""
        return tuple(each[0] for each in self.values) if isinstance(self.values, list) else ()


class Flat(NamedTuple):
    """For how long a channel had one value, at the longest."""

    label: str
    value: float
    seconds: float


class Constants:
    """Finds channels of another program's stream that have one value for longer than a body's can.

    Of our own streams, the agent tells that itself.
    """

    def __init__(self, header: RecordedHeader) -> None:
        is_judged = header.is_regular and not header.is_ours
        self._limit_s = constant_s(header.content_type) if is_judged else None
        self._labels = header.labels
        self._piece = min(max(_FEWEST, round(header.rate)), _MOST)
        self._values = np.full(header.channel_count, np.nan)
        self._since = np.full(header.channel_count, np.nan)
        self._newest = math.nan
        self._longest = [Flat(each, math.nan, 0.0) for each in self._labels]

    def add(self, block: Block) -> None:
        """Take the next samples; about a second of them is compared at once."""
        if self._limit_s is None or isinstance(block.values, list):
            return
        for begin in range(0, len(block.stamps), self._piece):
            end = begin + self._piece
            self._add(block.stamps[begin:end], block.values[begin:end], self._limit_s)

    def _add(self, stamps: NDArray[np.float64], values: NDArray[Any], limit_s: float) -> None:
        first, last = values[0], values[-1]
        if ((first < last) | (first > last)).all():
            # The usual case, and the rest costs as much as all else that is judged of a chunk.
            self._values[:] = self._since[:] = np.nan
            self._newest = float(stamps[-1])
            return
        # NaN stands for no value, and is ignored.
        low, high = np.fmin.reduce(values), np.fmax.reduce(values)
        is_one = low == high
        # Of what was sent in a gap nothing is known.
        goes_on = 0.0 <= stamps[0] - self._newest < limit_s / 2
        is_same = goes_on & (np.isnan(low) | (is_one & (low == self._values)))
        self._since = np.where(is_same, self._since, np.where(is_one, stamps[0], np.nan))
        self._values = np.where(is_same, self._values, np.where(is_one, low, np.nan))
        self._newest = float(stamps[-1])
        seconds = self._newest - self._since
        for column in np.flatnonzero(seconds >= limit_s).tolist():
            if seconds[column] > self._longest[column].seconds:
                self._longest[column] = Flat(
                    self._labels[column], float(self._values[column]), float(seconds[column])
                )

    @property
    def found(self) -> tuple[Flat, ...]:
        """The channels that had one value for too long, but those of triggers."""
        return tuple(
            each
            for each in self._longest
            if not math.isnan(each.value) and not _RESTS.search(each.label)
        )


def flat_text(flat: Sequence[Flat]) -> str:
    """Return the sentence about channels that did not change."""
    named = ", ".join(
        # Without labels channels are numbered.
        f"{'channel ' * each.label.isdigit()}{each.label} (always {each.value:g})"
        for each in flat
    )
    have = "has" if len(flat) == 1 else "have"
    longest_s = max(each.seconds for each in flat)
    return (
        f"{named} {have} not changed for {longest_s:.0f} s, so this is not a body signal: check "
        "electrode, contact with the skin, cable, and the settings of the device"
    )


def decode(content: memoryview, header: RecordedHeader, last_stamp: float) -> Block:
    """Decode the content of a samples chunk, without the stream's number.

    Parameters
    ----------
    last_stamp
        Timestamp of the stream's previous sample, 0 before the first.

    Raises
    ------
    ChunkError
        If the samples do not fill the chunk exactly.
    """
    count, start = _variable_length(content, 0)
    body = content[start:]
    period = 1 / header.rate if header.is_regular else 0.0
    if header.format is ChannelFormat.STRING:
        return _decode_texts(body, count, header.channel_count, last_stamp, period)
    return _decode_numbers(body, count, header, last_stamp, period)


def _decode_numbers(
    body: memoryview, count: int, header: RecordedHeader, last_stamp: float, period: float
) -> Block:
    dtype = _DTYPES[header.format]
    stamped = record(header.format, header.channel_count)
    if len(body) == count * stamped.itemsize:
        # In most chunks every sample has a timestamp, so all samples have the same size.
        samples = np.frombuffer(body, stamped)
        if bool((samples["size"] == STAMP_BYTES).all()):
            return Block(samples["stamp"].copy(), samples["values"])
    value_bytes = header.channel_count * dtype.itemsize
    if count * (1 + value_bytes) > len(body):
        raise ChunkError("it is too short for its number of samples")
    offsets = _sample_offsets(body, count, value_bytes)
    raw = np.frombuffer(body, np.uint8)
    is_stamped = raw[offsets] == STAMP_BYTES
    given = _gather(raw, offsets[is_stamped] + 1, np.dtype("<f8"), 1)[:, 0]
    starts = offsets + 1 + np.where(is_stamped, STAMP_BYTES, 0)
    values = _gather(raw, starts, dtype, header.channel_count)
    return Block(
        _complete(given, is_stamped, last_stamp, period),
        values,
        unstamped=int(np.argmax(is_stamped)) if len(given) else count,
    )


@cache
def record(channel_format: ChannelFormat, channel_count: int) -> np.dtype[Any]:
    """Return the layout of a numeric sample that has a timestamp.

    Its fields are ``size`` (of the timestamp: 8 bytes), ``stamp`` and ``values``.
    """
    values = (_DTYPES[channel_format], (channel_count,))
    return np.dtype([("size", "u1"), ("stamp", "<f8"), ("values", *values)])


def _sample_offsets(body: memoryview, count: int, value_bytes: int) -> NDArray[np.int64]:
    """Return where each sample begins."""
    steps = {0: 1 + value_bytes, STAMP_BYTES: 1 + STAMP_BYTES + value_bytes}
    offsets: list[int] = []
    position = 0
    try:
        for _ in range(count):
            offsets.append(position)
            position += steps[body[position]]
    except (IndexError, KeyError):
        raise ChunkError("its samples cannot be distinguished") from None
    if position != len(body):
        raise ChunkError("its samples do not fill it")
    return np.array(offsets, np.int64)


def _gather(
    raw: NDArray[np.uint8], starts: NDArray[np.int64], dtype: np.dtype[Any], columns: int
) -> NDArray[Any]:
    """Read `columns` values at each start."""
    width = dtype.itemsize * columns
    picked = raw[starts[:, np.newaxis] + np.arange(width)]
    return picked.reshape(-1).view(dtype).reshape(len(starts), columns)


def _complete(
    given: NDArray[np.float64], is_stamped: NDArray[np.bool_], last_stamp: float, period: float
) -> NDArray[np.float64]:
    """Fill in omitted timestamps, each one period after the previous one."""
    # Periods count from the last given timestamp, or from the previous chunk.
    anchors = np.concatenate(([last_stamp], given))
    latest = np.cumsum(is_stamped)
    places = np.flatnonzero(is_stamped)
    positions = np.concatenate(([-1], places))
    steps = np.arange(len(is_stamped)) - positions[latest]
    return np.asarray(anchors[latest] + steps * period, np.float64)


def _decode_texts(
    body: memoryview, count: int, channel_count: int, last_stamp: float, period: float
) -> Block:
    if count * (1 + 2 * channel_count) > len(body):
        raise ChunkError("it is too short for its number of samples")
    stamps = np.empty(count)
    texts: Texts = []
    position, unstamped, guessed = 0, count, 0
    for index in range(count):
        if unstamped == count and position < len(body) and body[position]:
            unstamped = index
        last_stamp, position = _text_stamp(body, position, last_stamp, period)
        stamps[index] = last_stamp
        sample: list[str] = []
        for _ in range(channel_count):
            length, position = _variable_length(body, position)
            end = position + length
            if end > len(body):
                raise ChunkError("a text in it is longer than the chunk")
            text, is_guessed = decoded(body[position:end])
            sample.append(text)
            guessed += is_guessed
            position = end
        texts.append(tuple(sample))
    if position != len(body):
        raise ChunkError("its samples do not fill it")
    return Block(stamps, texts, unstamped, guessed)


def _text_stamp(
    body: memoryview, position: int, last_stamp: float, period: float
) -> tuple[float, int]:
    size = body[position] if position < len(body) else None
    if size == 0:
        return last_stamp + period, position + 1
    end = position + 1 + STAMP_BYTES
    if size != STAMP_BYTES or end > len(body):
        raise ChunkError("its samples cannot be distinguished")
    return float(np.frombuffer(body[position + 1 : end], "<f8")[0]), end


def _variable_length(body: memoryview, position: int) -> tuple[int, int]:
    """Read a number that is preceded by its size; return it and the offset of its end."""
    size = body[position] if position < len(body) else 0
    end = position + 1 + size
    if size not in _LENGTH_SIZES or end > len(body):
        raise ChunkError("a length in it cannot be read")
    return int.from_bytes(body[position + 1 : end], "little"), end


def decode_clock_offset(content: memoryview) -> tuple[float, float] | None:
    """Return the recorder's time of a measurement and the offset of the sender's clock, in seconds.

    None if it was not measured: for an outlet that has just closed, and for another computer that
    does not answer at first, LabRecorder writes a clock time of 0.

    Raises
    ------
    ChunkError
        If it is invalid.
    """
    if len(content) != _CLOCK_OFFSET.size:
        raise ChunkError("it does not have the size of a clock offset")
    taken_at, offset = _CLOCK_OFFSET.unpack(content)
    if not (math.isfinite(taken_at) and math.isfinite(offset)):
        raise ChunkError("its times are not numbers")
    return (taken_at, offset) if taken_at else None
