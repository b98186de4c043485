"""Writes tables, JSON and notes again without one person."""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

from biosensor_gateway.recording.withdrawal.traces import Person
from biosensor_gateway.system.new_file import new_file

TABLES = (".csv", ".tsv", ".csv.gz", ".tsv.gz")
NOTES = (".txt", ".md", ".log", ".vmrk", ".vhdr")
LONGEST_JSON = 64_000_000


def is_table(path: Path) -> bool:
    """Whether it is a table, packed or not."""
    return path.name.lower().endswith(TABLES)


def is_text(path: Path) -> bool:
    """Whether lines or objects of it can be taken out."""
    return is_table(path) or path.suffix.lower() in (*NOTES, ".json")


def open_plain(path: Path) -> BinaryIO:
    """Open a file, unpacked if it is packed by gzip."""
    with path.open("rb") as file:
        is_packed = file.read(2) == b"\x1f\x8b"
    return gzip.open(path, "rb") if is_packed else path.open("rb")  # type: ignore[return-value]


def lines_of(path: Path, person: Person) -> int:
    """Return how many lines of a file name a person."""
    with open_plain(path) as file:
        return sum(person.is_in_bytes(each) for each in _rows(file, path))


def write_without(path: Path, target: Path, person: Person) -> None:
    """Write it without the lines, or in JSON the objects, that name a person.

    Raises
    ------
    OSError
        If it cannot be read or written.
    ValueError
        If JSON cannot be read.
    """
    with open_plain(path) as file, new_file(target, like=path) as new:
        kept = _of_json(file, person) if path.suffix == ".json" else _kept(file, path, person)
        if path.suffix == ".gz":
            with gzip.GzipFile("", "wb", 4, new, mtime=0) as packed:
                packed.writelines(kept)
        else:
            new.writelines(kept)


def _of_json(file: BinaryIO, person: Person) -> Iterator[bytes]:
    pruned = person.pruned(json.loads(file.read(LONGEST_JSON).decode("utf-8", "replace")))
    yield (json.dumps(pruned, indent=2, ensure_ascii=False) + "\n").encode()


def _kept(file: BinaryIO, path: Path, person: Person) -> Iterator[bytes]:
    return (each for each in _rows(file, path) if not person.is_in_bytes(each))


def _rows(lines: Iterable[bytes], path: Path) -> Iterator[bytes]:
    """Give the rows of a table: in quotes a cell may have several lines."""
    if ".csv" not in path.name.lower():
        yield from lines
        return
    row = b""
    for line in lines:
        row += line
        if row.count(b'"') % 2 == 0:
            yield row
            row = b""
    if row:
        yield row
