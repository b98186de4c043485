"""Read EEG or EMG of a BIDS dataset with mne-bids, as its users do, and print what it read.

    python eeg_reads.py DATASET DATATYPE

The output is a JSON list with an object for each run: its name, rate, names and types of the
channels, the bits of all values in single precision (microvolts) and the annotations.
"""

from __future__ import annotations

import importlib
import json
import sys
from typing import Any

# By name, since it is in the peers' environment only, where nothing is type-checked.
mne_bids: Any = importlib.import_module("mne_bids")


def read(path: Any) -> dict[str, Any]:
    """Read one run."""
    raw = mne_bids.read_raw_bids(path, verbose="error")
    noted = raw.annotations
    return {
        "name": path.basename,
        "rate": raw.info["sfreq"],
        "channels": raw.ch_names,
        "types": raw.get_channel_types(),
        "bits": (raw.get_data() * 1e6).astype("float32").T.ravel().view("uint32").tolist(),
        "annotations": [
            [float(onset), float(length), str(text)]
            for onset, length, text in zip(
                noted.onset, noted.duration, noted.description, strict=True
            )
        ],
    }


extension = {"eeg": ".vhdr", "emg": ".bdf"}[sys.argv[2]]
paths = mne_bids.find_matching_paths(sys.argv[1], datatypes=sys.argv[2], extensions=extension)
print(json.dumps([read(path) for path in paths]))
