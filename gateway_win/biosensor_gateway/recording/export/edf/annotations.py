"""Annotations of EDF+: what happened, in a signal of its own beside those of numbers.

Each data record has room for the same number of bytes of them. It begins with its own time;
what finds no room in its record stands in a later one, for each tells its own time, too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

BYTES_PER_SAMPLE = 3
_MOST_CHARACTERS = 256
_USUAL_BYTES = 60
# What separates times and texts.
_SEPARATORS = str.maketrans({0x14: " ", 0x15: " ", 0x00: " "})


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
    told = [(each.begin_s, _encoded(each, start_s)) for each in annotations]
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


def _encoded(annotation: Annotation, start_s: float) -> bytes:
    text = annotation.text.translate(_SEPARATORS)
    if len(text) > _MOST_CHARACTERS:
        text = f"{text[: _MOST_CHARACTERS - 3]}..."
    length = b"\x15" + _plain(annotation.length_s) if annotation.length_s else b""
    return _time(annotation.begin_s + start_s) + length + b"\x14" + text.encode() + b"\x14\x00"


def _time(seconds: float) -> bytes:
    return (b"-" if seconds < 0 else b"+") + _plain(abs(seconds))


def _plain(seconds: float) -> bytes:
    return f"{seconds:.6f}".rstrip("0").rstrip(".").encode()
