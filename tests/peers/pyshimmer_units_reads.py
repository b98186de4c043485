"""Read all sensors of an ExG unit with pyshimmer, another project's client, and print them.

    python pyshimmer_units_reads.py PORT

pyshimmer is under the GPL: this program runs in an environment of its own, as a process of its
own, and nothing of this project imports it or is imported by it. Its output is one JSON object:
calibration, gains and raw values as the client decodes them.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import sys
import threading
from typing import Any

import serial

# By name, since it is in the peers' environment only, where nothing is type-checked.
_pyshimmer: Any = importlib.import_module("pyshimmer")
_channels: Any = importlib.import_module("pyshimmer.dev.channels")

PACKETS = 100
PATIENCE_S = 20.0
GROUPS = ("ACCEL_LN", "GYRO", "ACCEL_WR", "MAG", "PRESSURE", "EXG1_24BIT", "EXG2_24BIT")


def calibration(device: Any) -> list[dict[str, Any]]:
    """Return the blocks of the device's memory."""
    told = device.get_all_calibration()
    return [
        {
            "offset": told.get_offset_bias(block),
            "sensitivity": told.get_sensitivity(block),
            "alignment": told.get_ali_mat(block),
        }
        for block in range(4)
    ]


def read(device: Any) -> dict[str, Any]:
    """Let the device stream and return what it said."""
    packets: list[dict[str, int]] = []
    enough = threading.Event()

    def packet(found: Any) -> None:
        if len(packets) < PACKETS:
            packets.append({each.name: int(found[each]) for each in found.channels})
        else:
            enough.set()

    device.set_sensors([_channels.ESensorGroup[name] for name in GROUPS])
    registers = [device.get_exg_register(chip) for chip in (0, 1)]
    result = {
        "calibration": calibration(device),
        "gains": [[each.ch1_gain, each.ch2_gain] for each in registers],
        "channels": [each.name for each in device.get_inquiry()[2]],
    }
    device.add_stream_callback(packet)
    device.start_streaming()
    enough.wait(PATIENCE_S)
    device.stop_streaming()
    return result | {"packets": packets}


def main() -> None:
    port = serial.Serial(sys.argv[1], 115200)
    # The client prints when its reading ends.
    with contextlib.redirect_stdout(sys.stderr), _pyshimmer.ShimmerBluetooth(port) as device:
        result = read(device)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
