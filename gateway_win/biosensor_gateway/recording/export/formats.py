"""All export formats by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module

from biosensor_gateway.recording.export.exporter import Exporter

_HERE = "biosensor_gateway.recording.export"


def _load(module: str, attribute: str, **options: bool) -> Exporter:
    # Imported on demand, because some import large libraries.
    return getattr(import_module(f"{_HERE}.{module}"), attribute)(**options)


FORMATS: Mapping[str, Callable[[], Exporter]] = {
    "bids": partial(_load, "bids.dataset", "BidsDataset"),
    "csv": partial(_load, "csv.wide", "WideCsv"),
    "csv.gz": partial(_load, "csv.wide", "WideCsv", is_packed=True),
    "csv-long": partial(_load, "csv.long", "LongCsv"),
    "csv-long.gz": partial(_load, "csv.long", "LongCsv", is_packed=True),
    "edf": partial(_load, "edf.exporter", "Edf"),
    "kubios": partial(_load, "kubios", "Kubios"),
    "ledalab": partial(_load, "ledalab", "Ledalab"),
    "mcap": partial(_load, "mcap.exporter", "McapExporter"),
}
"""Functions that create the exporter of each format."""

FOR_WHOM: Mapping[str, str] = {
    "bids": "a BIDS data set, for sharing and for pipelines; several recordings become one",
    "csv": "a table for each stream, for Excel, R, Python and SPSS",
    "csv.gz": "the same, packed",
    "csv-long": "one table of all, a line for each value",
    "csv-long.gz": "the same, packed",
    "edf": "EDF+ in 24 bits (BDF), for EDFbrowser, EEGLAB and MNE",
    "kubios": "intervals between beats, and ECG, for Kubios HRV",
    "ledalab": "skin conductance, for Ledalab",
    "mcap": "a ROS bag, with the topics of the node",
}
"""Short descriptions of the formats."""

GROWTH: Mapping[str, float] = {
    "csv": 3.0,
    "csv.gz": 1.5,
    "csv-long": 20.0,
    "csv-long.gz": 3.0,
    "mcap": 8.0,
    "bids": 3.0,
}
"""Size of a format on the disk, as a multiple of the samples in the recording."""
NEED_RATES = frozenset({"bids", "edf", "kubios"})
"""Formats in which a stream needs a rate; see `recording.contents.rates`."""
USUAL_GROWTH = 2.0
"""The multiple for formats that are not listed."""
