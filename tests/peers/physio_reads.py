"""Read physio tables of a BIDS dataset with pandas, as its users do, and print what it read.

    python physio_reads.py FILE.tsv.gz...

The output is a JSON list with an object for each: columns, rows, the times of the samples,
and by column the bits of their values in single precision.
"""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from typing import Any

# By name, since it is in the peers' environment only, where nothing is type-checked.
pandas: Any = importlib.import_module("pandas")


def read(file: str) -> dict[str, Any]:
    """Read one table by what its sidecar says."""
    sidecar = json.loads(Path(file.removesuffix(".tsv.gz") + ".json").read_text("utf-8"))
    columns: list[str] = sidecar["Columns"]
    table = pandas.read_csv(file, sep="\t", header=None, names=columns, na_values="n/a")
    present = table[table["timestamp"].notna()]
    return {
        "columns": columns,
        "rows": len(table),
        "timestamps": present["timestamp"].tolist(),
        "bits": {
            name: present[name].to_numpy("float32").view("uint32").tolist() for name in columns[1:]
        },
    }


print(json.dumps([read(file) for file in sys.argv[1:]]))
