"""Read an EmotiBit with BrainFlow, another project's client, and print what it read.

    python brainflow_reads_emotibit.py ADDRESS ID

Its output is one JSON object: for each kind of signal its rows, as the client decodes them.
Its own times are the computer's, so they are left out.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from typing import Any

# By name, since it is in the peers' environment only, where nothing is type-checked.
_brainflow: Any = importlib.import_module("brainflow.board_shim")

EMOTIBIT = 47
SAMPLES = 60
PATIENCE_S = 30.0
# Preset and key of the description.
KINDS = {
    "acc": (0, "accel_channels"),
    "gyro": (0, "gyro_channels"),
    "mag": (0, "magnetometer_channels"),
    "ppg": (1, "ppg_channels"),
    "eda": (2, "eda_channels"),
}


def main() -> None:
    shim = _brainflow.BoardShim
    shim.disable_board_logger()
    parameters = _brainflow.BrainFlowInputParams()
    parameters.ip_address, parameters.serial_number = sys.argv[1:]
    parameters.timeout = 10
    board = shim(EMOTIBIT, parameters)
    board.prepare_session()
    try:
        board.start_stream()
        presets = sorted({preset for preset, _ in KINDS.values()})
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            if all(board.get_board_data_count(preset) >= SAMPLES for preset in presets):
                break
            time.sleep(0.05)
        board.stop_stream()
        data = {preset: board.get_board_data(preset=preset) for preset in presets}
    finally:
        board.release_session()
    rows = {
        kind: data[preset][shim.get_board_descr(EMOTIBIT, preset)[key], :SAMPLES].T.tolist()
        for kind, (preset, key) in KINDS.items()
    }
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
