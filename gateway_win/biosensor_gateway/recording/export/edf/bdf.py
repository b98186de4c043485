"""The BDF+ format: channels and their ranges, data records with annotations, the header.

All data records reserve the same number of bytes for annotations, which begin with the record's
time. Annotations that do not fit into their record go to a later one, since each contains its own
time. edfio only writes complete files from memory. Here it creates a file of one record, of which
only the header is used, with the actual number of records.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np
from edfio import Bdf, BdfSignal, EdfAnnotation, Patient, Recording
from numpy.typing import NDArray

from biosensor_common.quantities import Unit

LEAST, GREATEST = -(1 << 23), (1 << 23) - 1
"""Range of a sample in 24 bits."""

RATES_HZ = (1e-3, 1e6)
"""Lowest and highest plausible rate that fits into a header."""

_FIELD = 8
_ROOM_BELOW = 1e-3
"""Part of a channel's range."""
_ANY_RANGE = 0.0, 1.0
# With a rate from a damaged header, one record could exceed the memory.
_SHORT = 10_000
"""Width of a number in the header, in characters."""
_DIMENSIONS: dict[str, str] = {
    Unit.MICROVOLTS: "uV",
    Unit.MILLIVOLTS: "mV",
    Unit.MICROSIEMENS: "uS",
    Unit.CELSIUS: "degC",
    Unit.NONE: "",
}
_IN_MICROVOLTS = {"V": 1e6, "volts": 1e6, "volt": 1e6}


class Channel(NamedTuple):
    """One channel of a file."""

    place: int  # Index of the channel in the stream.
    label: str
    dimension: str
    factor: float  # Factor that converts its values to `dimension`.
    # least, greatest: range in `dimension`, rounded to what the header can express.
    least: float
    greatest: float

    @property
    def step(self) -> float:
        """Size of one digital step in `dimension`."""
        return (self.greatest - self.least) / (GREATEST - LEAST)


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of the data records of one file."""

    samples: int  # Samples per channel in a record.
    record_s: float  # Duration of a record, rounded to what the header can express.
    records: int

    @property
    def rate_hz(self) -> float:
        """The rate that a reader calculates from it."""
        return self.samples / self.record_s


def layout(count: int, rate_hz: float) -> Layout:
    """Return a layout with records of about a second for this number of samples.

    Parameters
    ----------
    rate_hz
        Within `RATES_HZ`; may be a fraction.
    """
    samples = max(1, min(round(rate_hz), max(count, _SHORT)))
    length_s = samples / rate_hz
    decimals = max(0, _FIELD - 1 - len(str(int(length_s))))
    return Layout(samples, round(length_s, decimals), math.ceil(count / samples))


def channel(place: int, label: str, unit: str, least: float, greatest: float) -> Channel | None:
    """Return a channel to write; None if its range does not fit into the header.

    Parameters
    ----------
    least, greatest
        Range of its values; infinite if it has none.
    """
    factor = _IN_MICROVOLTS.get(unit, 1.0)
    dimension = "uV" if unit in _IN_MICROVOLTS else _DIMENSIONS.get(unit, unit)
    if not least <= greatest:
        least = greatest = 0.0
    least, greatest = least * factor, greatest * factor
    # The number for a missing value is below all values.
    below = _ROOM_BELOW * ((greatest - least) or 1.0)
    low, high = _outward(least - below, math.floor), _outward(greatest, math.ceil)
    if low is None or high is None:
        return None
    if low == high:
        high = low + 1
    text = "".join(char for char in dimension if " " <= char <= "~")[:_FIELD]
    return Channel(place, label, text, factor, low, high)


def _outward(value: float, rounded: Callable[[float], int]) -> float | None:
    """Return the next number in the direction of `rounded` with at most 8 characters."""
    for decimals in range(_FIELD - 2, -1, -1):
        scale = 10**decimals
        if not math.isfinite(value * scale):
            continue  # nothing is dropped: with fewer decimals it may be written
        found = rounded(value * scale) / scale
        if len(f"{found:.{decimals}f}") <= _FIELD:
            return found
    return None


BYTES_PER_SAMPLE = 3
MOST_CHARACTERS = 256
"""Longest annotation; longer ones are cut off."""
_USUAL_BYTES = 60
# These bytes separate times and texts.
_SEPARATORS = str.maketrans({0x14: " ", 0x15: " ", 0x00: " "})


def digital(values: NDArray[Any], channels: Sequence[Channel]) -> NDArray[np.int32]:
    """Return the values as 24-bit integers; NaN becomes the minimum, which no other value uses.

    Parameters
    ----------
    values : ndarray, shape (n_samples, n_channels_of_the_stream)

    Returns
    -------
    ndarray of int32, shape (n_samples, n_channels)
    """
    picked = np.asarray(values[:, [each.place for each in channels]], np.float64)
    factors, least, steps = np.array([(c.factor, c.least, c.step) for c in channels]).T
    found = np.rint((picked * factors - least) / steps) + LEAST
    found = np.where(np.isfinite(found), np.clip(found, LEAST + 1, GREATEST), LEAST)
    return np.asarray(found, np.int32)


def records(
    pieces: Iterable[NDArray[np.int32]], samples: int, annotations: Sequence[bytes], room: int
) -> Iterator[bytes]:
    """Yield complete data records as bytes; the last one is padded with its last sample.

    Parameters
    ----------
    pieces : iterable of ndarray, shape (n_samples, n_channels)
    samples
        Samples per channel in a record.
    room
        Bytes reserved for annotations in each record.
    """
    done, rest = 0, None
    for piece in pieces:
        joined = piece if rest is None else np.concatenate((rest, piece))
        whole = len(joined) // samples * samples
        rest = joined[whole:]
        if whole:
            told = annotations[done : done + whole // samples]
            yield _encoded(joined[:whole], samples, told, room)
            done += whole // samples
    if rest is not None and len(rest):
        filled = np.concatenate((rest, np.repeat(rest[-1:], samples - len(rest), axis=0)))
        yield _encoded(filled, samples, annotations[done : done + 1], room)


def _encoded(
    steps: NDArray[np.int32], samples: int, annotations: Sequence[bytes], room: int
) -> bytes:
    count, width = len(annotations), steps.shape[1]
    by_channel = steps.reshape(count, samples, width).transpose(0, 2, 1).astype("<i4", order="C")
    numbers = (
        by_channel.view(np.uint8).reshape(count, -1, 4)[:, :, :BYTES_PER_SAMPLE].reshape(count, -1)
    )
    texts = b"".join(each.ljust(room, b"\0") for each in annotations)
    told = np.frombuffer(texts, np.uint8).reshape(count, room)
    return np.concatenate((numbers, told), axis=1).tobytes()


class Annotation(NamedTuple):
    """An annotation, in s since the first sample; `length_s` is 0 for a moment."""

    begin_s: float
    length_s: float
    text: str


def annotation_records(
    annotations: Sequence[Annotation], records: int, record_s: float, start_s: float
) -> tuple[list[bytes], int]:
    """Return the annotation bytes of each record, and how many to reserve.

    Parameters
    ----------
    annotations
        In time order.
    records, record_s
        Number and duration of the data records.
    start_s
        Time of the first sample after the header's start time, which is in whole seconds.
    """
    told = [(each.begin_s, _encoded_annotation(each, start_s)) for each in annotations]
    longest = max((len(text) for _, text in told), default=0)
    room = max(_USUAL_BYTES, longest + _USUAL_BYTES)
    while (placed := _placed(told, records, record_s, start_s, room)) is None:
        room *= 2
    return placed, -(-room // BYTES_PER_SAMPLE) * BYTES_PER_SAMPLE


def _placed(
    told: Sequence[tuple[float, bytes]], records: int, record_s: float, start_s: float, room: int
) -> list[bytes] | None:
    """Return the annotation bytes of each record; None if there is not enough room."""
    waiting, end_s = deque(told), records * record_s
    found: list[bytes] = []
    for number in range(records):
        is_last = number == records - 1
        content = _time(number * record_s + start_s) + b"\x14\x14\x00"
        until_s = (number + 1) * record_s
        # Annotations after the end of the file may go anywhere, so they need not fill the last
        # record.
        while waiting and (is_last or waiting[0][0] < until_s or waiting[0][0] >= end_s):
            if len(content) + len(waiting[0][1]) > room:
                break
            content += waiting.popleft()[1]
        found.append(content)
    return None if waiting else found


def _encoded_annotation(annotation: Annotation, start_s: float) -> bytes:
    text = annotation.text.translate(_SEPARATORS)
    if len(text) > MOST_CHARACTERS:
        text = f"{text[: MOST_CHARACTERS - 3]}..."
    length = b"\x15" + _plain(annotation.length_s) if annotation.length_s else b""
    return _time(annotation.begin_s + start_s) + length + b"\x14" + text.encode() + b"\x14\x00"


def _time(seconds: float) -> bytes:
    return (b"-" if seconds < 0 else b"+") + _plain(abs(seconds))


def _plain(seconds: float) -> bytes:
    return f"{seconds:.6f}".rstrip("0").rstrip(".").encode()


_RECORDS_AT = 236
# In the header, label, transducer and dimension precede the ranges; ranges and filter precede the
# number of samples.
_BEFORE_RANGES = 16 + 80 + 8
_BEFORE_SAMPLES = _BEFORE_RANGES + 4 * _FIELD + 80
_FIXED = 256
_NOT_PLAIN = re.compile(r"[^!-~]+")
_MOST_CODE = 24


@dataclass(frozen=True, slots=True)
class Facts:
    """Information about the recording for the header."""

    # participant, equipment: empty if unknown.
    participant: str
    equipment: str
    # Unix time of the first sample; None if the file should not have a time of day.
    begun_ns: int | None

    @property
    def start_s(self) -> float:
        """Time of the first sample after the header's start time, which is in whole seconds."""
        return 0.0 if self.begun_ns is None else self.begun_ns % 1_000_000_000 / 1e9


def header(
    channels: Sequence[Channel], layout: Layout, facts: Facts, annotation_bytes: int
) -> bytes:
    """Return the bytes before the data records."""
    signals = [
        BdfSignal(
            np.zeros(layout.samples),
            layout.rate_hz,
            label=each.label,
            physical_dimension=each.dimension,
            physical_range=_ANY_RANGE,
            digital_range=(LEAST, GREATEST),
        )
        for each in channels
    ]
    begun = None
    if facts.begun_ns is not None:
        begun = datetime.fromtimestamp(facts.begun_ns // 1_000_000_000, UTC)
    made = Bdf(
        signals,
        patient=Patient(code=_code(facts.participant)),
        recording=Recording(
            startdate=begun.date() if begun else None, equipment_code=_code(facts.equipment)
        ),
        starttime=begun.time() if begun else None,
        data_record_duration=layout.record_s,
        annotations=[EdfAnnotation(0, None, "begin")],
    )
    content = bytearray(made.to_bytes()[: made.bytes_in_header_record])
    _put(content, _RECORDS_AT, layout.records)
    # Annotations form the last signal.
    count = len(channels) + 1
    place = _FIXED + count * _BEFORE_SAMPLES + (count - 1) * _FIELD
    _put(content, place, annotation_bytes // BYTES_PER_SAMPLE)
    # edfio would round these ranges again, and cannot write small ones.
    place = _FIXED + count * _BEFORE_RANGES
    for number, each in enumerate(channels):
        _put(content, place + number * _FIELD, each.least)
        _put(content, place + (count + number) * _FIELD, each.greatest)
    return bytes(content)


def _put(content: bytearray, place: int, number: float) -> None:
    text = f"{number:.6f}".rstrip("0").rstrip(".")
    content[place : place + _FIELD] = text.encode().ljust(_FIELD)


def _code(text: str) -> str:
    return _NOT_PLAIN.sub("_", text)[:_MOST_CODE] or "X"
