"""The form of a BDF+ file: channels and their ranges, data records with annotations, the header.

Each data record has room for the same number of bytes of annotations, which begin with its time.
What finds no room in its record stands in a later one, for each annotation tells its own time.
edfio writes whole files that are in memory. Here it makes a file of one record, of which only the
header is taken, with the number of records that will follow.
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
"""Of a sample, in 24 bits."""

RATES_HZ = (1e-3, 1e6)
"""Lowest and highest rate that makes sense, and that a header can say."""

_FIELD = 8
# A damaged header may claim a rate that would make one record larger than the memory.
_SHORT = 10_000
"""Characters that a number has in the header."""
_DIMENSIONS: dict[str, str] = {
    Unit.MICROVOLTS: "uV",
    Unit.MILLIVOLTS: "mV",
    Unit.MICROSIEMENS: "uS",
    Unit.CELSIUS: "degC",
    Unit.NONE: "",
}
_IN_MICROVOLTS = {"V": 1e6, "volts": 1e6, "volt": 1e6}


class Channel(NamedTuple):
    """One channel of a file.

    Attributes
    ----------
    place
        Its place in the stream.
    factor
        By which its values are multiplied to be in `dimension`.
    least, greatest
        Of the values in `dimension`, as the header can say them.
    """

    place: int
    label: str
    dimension: str
    factor: float
    least: float
    greatest: float

    @property
    def step(self) -> float:
        """What one digital step is in `dimension`."""
        return (self.greatest - self.least) / (GREATEST - LEAST)


@dataclass(frozen=True, slots=True)
class Layout:
    """Of the data records of one file.

    Attributes
    ----------
    samples
        Of each channel in a record.
    record_s
        How long a record is, as the header can say it.
    records
        How many.
    """

    samples: int
    record_s: float
    records: int

    @property
    def rate_hz(self) -> float:
        """The rate that a reader makes of it."""
        return self.samples / self.record_s


def layout(count: int, rate_hz: float) -> Layout:
    """Return records of about a second for so many samples at a rate, which need not be whole.

    Parameters
    ----------
    rate_hz
        In `RATES_HZ`.
    """
    samples = max(1, min(round(rate_hz), max(count, _SHORT)))
    length_s = samples / rate_hz
    decimals = max(0, _FIELD - 1 - len(str(int(length_s))))
    return Layout(samples, round(length_s, decimals), math.ceil(count / samples))


def channel(place: int, label: str, unit: str, least: float, greatest: float) -> Channel | None:
    """Return how a channel is written; None if its values do not fit into the header.

    Parameters
    ----------
    least, greatest
        Of its values; infinite if it has none.
    """
    factor = _IN_MICROVOLTS.get(unit, 1.0)
    dimension = "uV" if unit in _IN_MICROVOLTS else _DIMENSIONS.get(unit, unit)
    if not least <= greatest:
        least = greatest = 0.0
    low, high = _outward(least * factor, math.floor), _outward(greatest * factor, math.ceil)
    if low is None or high is None:
        return None
    if low == high:
        high = low + 1
    text = "".join(char for char in dimension if " " <= char <= "~")[:_FIELD]
    return Channel(place, label, text, factor, low, high)


def _outward(value: float, rounded: Callable[[float], int]) -> float | None:
    """Return the next number outwards that has at most 8 characters."""
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
"""Of an annotation; a longer one is cut off."""
_USUAL_BYTES = 60
# What separates times and texts.
_SEPARATORS = str.maketrans({0x14: " ", 0x15: " ", 0x00: " "})


def digital(values: NDArray[Any], channels: Sequence[Channel]) -> NDArray[np.int32]:
    """Return steps of 24 bits; what is no number is the least one.

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
    found = np.where(np.isfinite(found), found, LEAST)
    return np.asarray(np.clip(found, LEAST, GREATEST), np.int32)


def records(
    pieces: Iterable[NDArray[np.int32]], samples: int, annotations: Sequence[bytes], room: int
) -> Iterator[bytes]:
    """Give bytes of whole data records; the last one is filled up with its last sample.

    Parameters
    ----------
    pieces : iterable of ndarray, shape (n_samples, n_channels)
    samples
        In a record.
    annotations
        Of each record.
    room
        Bytes for them.
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
    """What happened, in s since the first sample; `length_s` is 0 for a moment."""

    begin_s: float
    length_s: float
    text: str


def annotation_records(
    annotations: Sequence[Annotation], records: int, record_s: float, start_s: float
) -> tuple[list[bytes], int]:
    """Return what stands in each record, and the bytes that each is to have.

    Parameters
    ----------
    annotations
        In the order of time.
    records, record_s
        How many data records, and how long each is.
    start_s
        Time of the first sample since the whole second that the header tells.
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
    """Return what stands in each record; None if there is not enough room for all."""
    waiting, end_s = deque(told), records * record_s
    found: list[bytes] = []
    for number in range(records):
        is_last = number == records - 1
        content = _time(number * record_s + start_s) + b"\x14\x14\x00"
        until_s = (number + 1) * record_s
        # What is after the file's end may stand anywhere, and shall not all stand in the last.
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
# Label, transducer and dimension come before the ranges, those and the filter before the samples.
_BEFORE_RANGES = 16 + 80 + 8
_BEFORE_SAMPLES = _BEFORE_RANGES + 4 * _FIELD + 80
_FIXED = 256
_NOT_PLAIN = re.compile(r"[^!-~]+")
_MOST_CODE = 24


@dataclass(frozen=True, slots=True)
class Facts:
    """What the header tells of the recording.

    Attributes
    ----------
    participant, equipment
        Empty if not known.
    begun_ns
        Unix time of the first sample; None if the file is to tell no time of day.
    """

    participant: str
    equipment: str
    begun_ns: int | None

    @property
    def start_s(self) -> float:
        """Time of the first sample since the whole second that the header tells."""
        return 0.0 if self.begun_ns is None else self.begun_ns % 1_000_000_000 / 1e9


def header(
    channels: Sequence[Channel], layout: Layout, facts: Facts, annotation_bytes: int
) -> bytes:
    """Return the bytes before the data records."""
    signals = [
        BdfSignal(
            np.full(layout.samples, each.least),
            layout.rate_hz,
            label=each.label,
            physical_dimension=each.dimension,
            physical_range=(each.least, each.greatest),
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
    # The annotations are the last signal.
    count = len(channels) + 1
    place = _FIXED + count * _BEFORE_SAMPLES + (count - 1) * _FIELD
    _put(content, place, annotation_bytes // BYTES_PER_SAMPLE)
    # edfio rounds them once more.
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
