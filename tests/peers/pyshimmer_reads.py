"""Drive a Shimmer3 with pyshimmer, another project's client, and print what it read.

    python pyshimmer_reads.py PORT

pyshimmer is under the GPL: this program runs in an environment of its own, as a process
of its own, and nothing of this project imports it or is imported by it. When it streams
it writes ``streaming`` on standard error and reads a line: after ``docked`` it waits for
a status that the device sends unasked. Its output is one JSON object.
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

PACKETS = 200
RATE_HZ = 128.0
RTC_S = 1_700_000_000.0
PATIENCE_S = 20.0
CHANNELS = ("TIMESTAMP", "VBATT", "INTERNAL_ADC_13", "GSR_RAW")


class Listener:
    """Collects packets and unasked statuses of the client's reading thread."""

    def __init__(self) -> None:
        self.packets: list[list[int]] = []
        self.statuses: list[list[bool]] = []
        self.enough = threading.Event()
        self.status_came = threading.Event()

    def packet(self, packet: Any) -> None:
        if len(self.packets) < PACKETS:
            self.packets.append([int(packet[_pyshimmer.EChannelType[name]]) for name in CHANNELS])
        else:
            self.enough.set()

    def status(self, status: list[bool]) -> None:
        self.statuses.append([bool(bit) for bit in status])
        self.status_came.set()


def configured(device: Any) -> dict[str, Any]:
    """Set the device up and return what it says of itself."""
    groups = _channels.ESensorGroup
    device.set_sensors([groups.GSR, groups.CH_A13, groups.BATTERY])
    device.set_sampling_rate(RATE_HZ)
    device.set_rtc(RTC_S)
    kind, version = device.get_firmware_version()
    rate, buffer_size, channels = device.get_inquiry()
    return {
        "firmware": [kind.name, version.major, version.minor, version.rel],
        "name": device.get_device_name(),
        "battery_percent": device.get_battery_state(in_percent=True),
        "battery_volts": device.get_battery_state(in_percent=False),
        "rate_hz": device.get_sampling_rate(),
        "inquiry": [rate, buffer_size, [channel.name for channel in channels]],
        "rtc_s": device.get_rtc() - RTC_S,
        "status": [bool(bit) for bit in device.get_status()],
    }


def read(device: Any) -> dict[str, Any]:
    """Let the device stream and return everything that it said."""
    listener = Listener()
    device.add_stream_callback(listener.packet)
    device.add_status_callback(listener.status)
    result = configured(device)
    device.start_streaming()
    sys.stderr.write("streaming\n")
    sys.stderr.flush()
    if sys.stdin.readline().strip() == "docked":
        listener.status_came.wait(PATIENCE_S)
    listener.enough.wait(PATIENCE_S)
    device.stop_streaming()
    device.send_ping()
    still = [bool(bit) for bit in device.get_status()]
    pushed = listener.statuses
    return result | {"packets": listener.packets, "pushed": pushed, "status_after": still}


def main() -> None:
    port = serial.Serial(sys.argv[1], 115200)
    # The client prints when its reading ends.
    with contextlib.redirect_stdout(sys.stderr), _pyshimmer.ShimmerBluetooth(port) as device:
        result = read(device)
    print(json.dumps(result))


if __name__ == "__main__":
    main()
