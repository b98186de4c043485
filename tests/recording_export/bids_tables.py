"""Reads tables of a dataset with nothing but the standard library."""

from __future__ import annotations

import gzip
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Table:
    """A table and its sidecar; rows are texts by the name of the column."""

    sidecar: dict[str, Any]
    rows: list[dict[str, str]]

    def of(self, column: str) -> list[str]:
        return [row[column] for row in self.rows]


def find(dataset: Path, pattern: str) -> Path:
    """The only file of that name."""
    (found,) = dataset.rglob(pattern)
    return found


def read(dataset: Path, name: str) -> Table:
    """The only table whose name ends so, without ``.tsv``: ``recording-ecg_physio``."""
    sidecar = json.loads(find(dataset, f"*{name}.json").read_text("utf-8"))
    path = find(dataset, f"*{name}.tsv*")
    data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    lines = [line.split("\t") for line in data.decode().split("\n")[:-1]]
    if "Columns" in sidecar:
        columns = sidecar["Columns"]
    elif name.endswith("_motion"):
        channels = path.with_name(path.name.replace("_motion", "_channels"))
        columns = [line.split("\t")[0] for line in channels.read_text().splitlines()[1:]]
    else:
        columns = lines.pop(0)
    assert {len(line) for line in lines} <= {len(columns)}
    return Table(sidecar, [dict(zip(columns, line, strict=True)) for line in lines])
