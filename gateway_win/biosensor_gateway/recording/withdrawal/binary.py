"""Finds and masks names in binary files, and never takes numbers for letters."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from biosensor_gateway.recording.withdrawal.traces import Person
from biosensor_gateway.system.new_file import new_file

EDF = (".bdf", ".edf")
_HEAD, _HEAD_OF_SIGNAL = 256, 256
_LABEL, _BEFORE_COUNTS = 16, 216
_BLOCK_BYTES = 1 << 20


class Layout(NamedTuple):
    """Where texts are in an EDF or BDF file: in its head, and in spans of each record."""

    head: int
    record: int
    spans: tuple[tuple[int, int], ...]


def layout_of(file: BinaryIO, path: Path) -> Layout:
    """Read the head of a file.

    Raises
    ------
    ValueError
        If it is none of these.
    """
    file.seek(0)
    head = file.read(_HEAD)
    count = int(head[252:256])
    signals = file.read(count * _HEAD_OF_SIGNAL)
    width = 3 if path.suffix.lower() == ".bdf" else 2
    begin = 0
    spans: list[tuple[int, int]] = []
    for number in range(count):
        label = signals[number * _LABEL : (number + 1) * _LABEL]
        at = count * _BEFORE_COUNTS + number * 8
        end = begin + width * int(signals[at : at + 8])
        if label.strip().endswith(b"Annotations"):
            spans.append((begin, end))
        begin = end
    return Layout(_HEAD + count * _HEAD_OF_SIGNAL, begin, tuple(spans))


def texts_of_edf(path: Path) -> Iterator[bytes]:
    """Give the head, and the annotations of each record.

    Raises
    ------
    ValueError
        If it is no such file.
    """
    with path.open("rb") as file:
        layout = layout_of(file, path)
        file.seek(0)
        yield file.read(layout.head)
        while layout.record and (record := file.read(layout.record)):
            for begin, end in layout.spans:
                yield record[begin:end]


def write_edf_without(path: Path, target: Path, person: Person) -> None:
    """Write it with other letters, as many, in place of a person's name.

    Raises
    ------
    OSError
        If it cannot be read or written.
    ValueError
        If it is no such file.
    """
    with path.open("rb") as file, new_file(target, like=path) as new:
        layout = layout_of(file, path)
        file.seek(0)
        new.write(person.blanked(file.read(layout.head)))
        while layout.record and (record := file.read(layout.record)):
            masked = bytearray(record)
            for begin, end in layout.spans:
                masked[begin:end] = person.blanked(record[begin:end])
            new.write(masked)


def is_in_message(content: bytes, person: Person) -> bool:
    """Whether a text in a message of ROS names a person.

    A text in CDR has its length before it, in four bytes, and a zero behind it.
    """
    for start, end in person.places(content):
        begin = content.rfind(b"\0", 0, start) + 1
        behind = content.find(b"\0", end)
        told = int.from_bytes(content[max(0, begin - 4) : begin], "little")
        if behind >= 0 and told == behind - begin + 1:
            return True
    return False
