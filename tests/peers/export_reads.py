"""Read exported recordings with the libraries of those who analyse them, and print what they read.

    python export_reads.py FORMAT=FILE...

pandas reads tables and texts, NeuroKit2 analyses what they hold, MNE reads BDF. The output
is one JSON object by file, NaN written as in Python.
"""

from __future__ import annotations

import importlib
import json
import sys
import warnings
from collections.abc import Callable
from typing import Any

# By name, since they are in the peers' environment only, where nothing is type-checked.
pandas: Any = importlib.import_module("pandas")


def read_table(file: str) -> dict[str, Any]:
    """Read a table of one stream as people do, without any option."""
    table = pandas.read_csv(file)
    types = {name: str(kind) for name, kind in table.dtypes.items()}
    columns = {name: table[name].tolist() for name in table.columns}
    return {"types": types, "columns": columns}


def read_long(file: str) -> dict[str, Any]:
    """Read the table of all streams, and turn one of them into a column a channel."""
    table = pandas.read_csv(file)
    groups = table.groupby("stream")["value"].count()
    numbers = table[table["value"].notna()]
    wide = numbers.pivot_table(index="lsl_time", columns=["stream", "channel"], values="value")
    return {
        "counts": {str(name): int(count) for name, count in groups.items()},
        "columns": ["/".join(map(str, name)) for name in wide.columns],
        "texts": table["text"].dropna().tolist(),
    }


def read_bdf(file: str) -> dict[str, Any]:
    """Read a BDF file by MNE."""
    mne: Any = importlib.import_module("mne")
    raw = mne.io.read_raw_bdf(file, preload=True, verbose="error")
    begun = raw.info["meas_date"]
    return {
        "names": raw.ch_names,
        "rate_hz": raw.info["sfreq"],
        "begun": None if begun is None else begun.isoformat(),
        "person": raw.info["subject_info"]["his_id"],
        "microvolts": (raw.get_data() * 1e6).tolist(),
        "told": [
            [float(each["onset"]), float(each["duration"]), str(each["description"])]
            for each in raw.annotations
        ],
    }


def read_intervals(file: str) -> dict[str, Any]:
    """Read intervals, and let NeuroKit2 say what the heart did."""
    neurokit: Any = importlib.import_module("neurokit2")
    intervals = pandas.read_csv(file, header=None)[0]
    peaks = neurokit.intervals_to_peaks((intervals * 1000).to_numpy(), sampling_rate=1000)
    figures = neurokit.hrv_time(peaks, sampling_rate=1000)
    return {"intervals": intervals.tolist(), "mean_ms": float(figures["HRV_MeanNN"].iloc[0])}


def read_conductance(file: str) -> dict[str, Any]:
    """Read time, conductance and marker, and let NeuroKit2 take the conductance apart."""
    neurokit: Any = importlib.import_module("neurokit2")
    table = pandas.read_csv(file, sep="\t", header=None, names=["time", "conductance", "marker"])
    parts = neurokit.eda_phasic(table["conductance"], sampling_rate=4, method="smoothmedian")
    total = parts["EDA_Tonic"] + parts["EDA_Phasic"]
    return {
        "times": table["time"].tolist(),
        "markers": table["marker"].tolist(),
        "conductance": table["conductance"].tolist(),
        "again": total.tolist(),
    }


_READERS: dict[str, Callable[[str], dict[str, Any]]] = {
    "csv": read_table,
    "long": read_long,
    "edf": read_bdf,
    "kubios": read_intervals,
    "ledalab": read_conductance,
}

if __name__ == "__main__":
    warnings.simplefilter("ignore")
    wanted = [argument.partition("=") for argument in sys.argv[1:]]
    json.dump({file: _READERS[kind](file) for kind, _, file in wanted}, sys.stdout)
