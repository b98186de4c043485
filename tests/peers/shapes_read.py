"""Read all exports of many recordings by the libraries of others, and print what they read.

    python shapes_read.py FOLDER...

In each folder are the exports of one recording, `rec_csv`, `rec_edf` and so on, and XDF files. The
output is a JSON object by folder and file: what could not be read, or the number of samples, the
sums of each channel and the markers.
"""

from __future__ import annotations

import importlib
import json
import logging
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

# By name, since they are in the peers' environment only, where nothing is type-checked.
numpy: Any = importlib.import_module("numpy")
pandas: Any = importlib.import_module("pandas")
pyedflib: Any = importlib.import_module("pyedflib")
pyxdf: Any = importlib.import_module("pyxdf")
mne: Any = importlib.import_module("mne")
mne_bids: Any = importlib.import_module("mne_bids")
mcap_reader: Any = importlib.import_module("mcap.reader")
mcap_ros2: Any = importlib.import_module("mcap_ros2.decoder")

Read = dict[str, Any]


def told(values: Any, markers: Any = ()) -> Read:
    """Return number, sums and markers; `values` has a row for each sample."""
    rows = numpy.asarray(values, "float64")
    sums = numpy.where(numpy.abs(rows) < 1e290, rows, 0.0).sum(axis=0)
    return {"count": len(rows), "sums": sums.tolist(), "markers": [str(each) for each in markers]}


def read_csv(file: Path) -> Read:
    """Read a table; one of markers has texts."""
    table = pandas.read_csv(file, keep_default_na=False, na_values=["NaN"])
    if file.name.startswith("all_markers"):
        return {"count": 0, "sums": [], "markers": table["marker"].astype(str).tolist()}
    columns = table.drop(columns=["lsl_time", "seconds"])
    if not all(pandas.api.types.is_numeric_dtype(kind) for kind in columns.dtypes):
        return {"count": len(table), "sums": None, "markers": []}
    return told(columns)


def read_long(file: Path) -> Read:
    """Read the table of all streams."""
    table = pandas.read_csv(file)
    return {"count": len(table), "sums": None, "markers": []}


def read_bdf(file: Path) -> Read:
    """Read by pyEDFlib and MNE, which must agree."""
    reader = pyedflib.EdfReader(str(file))
    signals = [reader.readSignal(at) for at in range(reader.signals_in_file)]
    texts = reader.readAnnotations()[2].tolist()
    reader.close()
    raw = mne.io.read_raw_bdf(file, preload=True, verbose="error")
    assert len(raw.ch_names) == len(signals), (raw.ch_names, len(signals))
    for by_mne, by_pyedflib in zip(raw.get_data(), signals, strict=True):
        # MNE fills the last record up with zeros; it has no unit but volts.
        assert len(by_mne) == len(by_pyedflib), (len(by_mne), len(by_pyedflib))
    return told(numpy.array(signals).T, texts)


def read_numbers(file: Path) -> Read:
    """Read the numbers of Kubios, a column for each channel."""
    table = pandas.read_csv(file, header=None, sep=r"\s+")
    return told(table)


def read_conductance(file: Path) -> Read:
    """Read time, conductance and marker."""
    return told(pandas.read_csv(file, sep="\t", header=None)[[1]])


def read_physio(file: Path) -> Read:
    """Read a table by what its sidecar says."""
    sidecar = json.loads(Path(str(file).removesuffix(".tsv.gz") + ".json").read_text("utf-8"))
    columns = sidecar["Columns"]
    table = pandas.read_csv(file, sep="\t", header=None, names=columns, na_values="n/a")
    if "timestamp" in columns:
        table = table[table["timestamp"].notna()]
    times = [each for each in ("timestamp", "onset") if each in columns]
    return told(table.drop(columns=times))


def read_motion(file: Path) -> Read:
    """Read a table of motion by the table of its channels."""
    channels = pandas.read_csv(str(file).removesuffix("motion.tsv") + "channels.tsv", sep="\t")
    table = pandas.read_csv(file, sep="\t", header=None, na_values="n/a")
    values = table.loc[:, (channels["type"] != "LATENCY").to_numpy()]
    return told(values[values.notna().any(axis=1)])


def read_events(file: Path) -> Read:
    """Read the events of a data set."""
    table = pandas.read_csv(file, sep="\t", keep_default_na=False)
    values = table[table["trial_type"] != "BAD_gap"]["value"]
    return {"count": 0, "sums": [], "markers": values.astype(str).tolist()}


def read_brain_vision(file: Path) -> Read:
    """Read a run by mne-bids, in microvolts."""
    raw = mne_bids.read_raw_bids(mne_bids.get_bids_path_from_fname(file), verbose="error")
    return told(raw.get_data().T * 1e6, raw.annotations.description)


def read_bag(file: Path) -> Read:
    """Read a bag; its stamped topics have each sample once."""
    count = 0
    markers: list[str] = []
    with file.open("rb") as opened:
        reader = mcap_reader.make_reader(
            opened, decoder_factories=[mcap_ros2.DecoderFactory()], validate_crcs=True
        )
        for schema, _, _, decoded in reader.iter_decoded_messages():
            if schema.name == "biosensor_msgs/msg/Samples":
                count += len(decoded.offsets_ns)
            elif schema.name == "biosensor_msgs/msg/Event":
                markers.append(decoded.data)
    return {"count": count, "sums": None, "markers": markers}


def read_xdf(file: Path) -> Read:
    """Read a recording by pyxdf."""
    streams, _ = pyxdf.load_xdf(str(file), dejitter_timestamps=False)
    return {"count": sum(len(each["time_stamps"]) for each in streams), "sums": None, "markers": []}


READERS: list[tuple[str, Callable[[Path], Read]]] = [
    ("rec_csv/*.csv", read_csv),
    ("rec.csv.gz", read_long),
    ("rec_edf/*.bdf", read_bdf),
    ("rec_kubios/*.txt", read_numbers),
    ("rec_ledalab/*.txt", read_conductance),
    ("rec_bids/**/*physio.tsv.gz", read_physio),
    ("rec_bids/**/*physioevents.tsv.gz", read_physio),
    ("rec_bids/**/*motion.tsv", read_motion),
    ("rec_bids/**/*_events.tsv", read_events),
    ("rec_bids/**/*.vhdr", read_brain_vision),
    ("rec_bids/**/*_emg.bdf", read_brain_vision),
    ("rec_bag/*.mcap", read_bag),
    ("*.xdf", read_xdf),
]


def read_all(folder: Path) -> Iterator[tuple[str, Read]]:
    """Yield what is read of each file of a folder."""
    for pattern, read in READERS:
        for file in sorted(folder.glob(pattern)):
            if file.name == "README.txt":
                continue
            try:
                found = read(file)
            except Exception as error:  # noqa: BLE001 - whatever it is, the test says it
                found = {"error": f"{type(error).__name__}: {error}"}
            yield str(file.relative_to(folder)), found


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    json.dump({each: dict(read_all(Path(each))) for each in sys.argv[1:]}, sys.stdout)
