"""Writes the text and JSON files of a dataset."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

NOTHING = "n/a"
"""BIDS notation for a missing value."""


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """Write a sidecar.

    Raises
    ------
    OSError
        If it exists or cannot be written.
    """
    write_text(path, json.dumps(content, indent=2, ensure_ascii=False) + "\n")


def write_rows(path: Path, rows: Iterable[Sequence[str]]) -> None:
    """Write a small table with its column names first; see :func:`line`.

    Raises
    ------
    OSError
        If it exists or cannot be written.
    """
    write_text(path, "".join(map(line, rows)))


def write_text(path: Path, text: str) -> None:
    """Write a text with unchanged line ends.

    Raises
    ------
    OSError
        If it exists or cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    # Headers and texts may contain unpaired surrogates.
    with path.open("x", encoding="utf-8", errors="replace", newline="\n") as file:
        file.write(text)


def line(cells: Sequence[str]) -> str:
    """Return a row of a table, without empty cells and without tabs or line ends in cells."""
    return "\t".join(map(cell, cells)) + "\n"


def cell(text: str) -> str:
    """Return text as one cell of a table."""
    clean = "".join(each if each.isprintable() else " " for each in text)
    return " ".join(clean.split()) or NOTHING
