"""Read a Shimmer3 with BrainFlow, another project's client, and print what it read.

    python brainflow_reads.py PORT

Its output is one JSON object: for each kind of signal its rows, raw values as the client
decodes them. Its own times and packet numbers are the computer's, so they are left out.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from typing import Any

# By name, since it is in the peers' environment only, where nothing is type-checked.
_brainflow: Any = importlib.import_module("brainflow.board_shim")

SHIMMER3 = 68
SAMPLES = 100
PATIENCE_S = 20.0
# Gyroscope, magnetometer, wide-range acceleration, both ExG chips with 24 bits.
SENSORS = "sensors:0x001078"
KINDS = ("accel", "gyro", "magnetometer", "ecg")


def main() -> None:
    shim = _brainflow.BoardShim
    shim.disable_board_logger()
    parameters = _brainflow.BrainFlowInputParams()
    parameters.serial_port = sys.argv[1]
    board = shim(SHIMMER3, parameters)
    board.prepare_session()
    try:
        told = board.config_board(SENSORS)
        board.start_stream()
        deadline = time.monotonic() + PATIENCE_S
        while board.get_board_data_count() < SAMPLES and time.monotonic() < deadline:
            time.sleep(0.05)
        board.stop_stream()
        data = board.get_board_data()
    finally:
        board.release_session()
    described = shim.get_board_descr(SHIMMER3)
    rows = {kind: data[described[f"{kind}_channels"], :SAMPLES].tolist() for kind in KINDS}
    print(json.dumps({"told": told, **rows}))


if __name__ == "__main__":
    main()
