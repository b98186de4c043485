"""Makes the data records of a BDF+ file: numbers, and annotations in a signal of their own.

Each data record has room for the same number of bytes of annotations, which begin with its time.
What finds no room in its record stands in a later one, for each annotation tells its own time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from biosensor_gateway.recording.export.edf.layout import GREATEST, LEAST, Channel

BYTES_PER_SAMPLE = 3
_MOST_CHARACTERS = 256
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
    if len(text) > _MOST_CHARACTERS:
        text = f"{text[: _MOST_CHARACTERS - 3]}..."
    length = b"\x15" + _plain(annotation.length_s) if annotation.length_s else b""
    return _time(annotation.begin_s + start_s) + length + b"\x14" + text.encode() + b"\x14\x00"


def _time(seconds: float) -> bytes:
    return (b"-" if seconds < 0 else b"+") + _plain(abs(seconds))


def _plain(seconds: float) -> bytes:
    return f"{seconds:.6f}".rstrip("0").rstrip(".").encode()
